"""All three sealed stages in order, outside DVC: in a small size (`make run`), or in a workspace of its own."""

from flows.sealed.start import main

if __name__ == "__main__":
    main("flows.sealed.prove", __doc__)  # before the imports, which take seconds

from pathlib import Path

from flows.flow import flow
from flows.sealed import conceal, examine, score
from tasks.params_sealed import SealedParams


@flow(name="prove", flow_run_name="prove-{suite}")
def run(suite: str, params: SealedParams, root: Path) -> None:
    """Conceal, examine and score a suite."""
    conceal.run(suite, params, root)
    examine.run(suite, params, root)
    score.run(suite, params, root)
