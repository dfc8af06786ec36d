"""Settings of a process that computes."""

import jaxlib.version
import pytest

from simgap.cli.environment import numerics


@pytest.mark.parametrize(
    ("version", "known"), [("0.10.2", True), ("0.10.9", True), ("0.11.0", False), ("1.0.0", False)]
)
def test_a_flag_that_other_versions_may_not_know_is_set_for_those_that_do(
    monkeypatch: pytest.MonkeyPatch, version: str, known: bool
) -> None:
    """A process whose XLA does not know a flag ends at once."""
    monkeypatch.setattr(jaxlib.version, "__version__", version)
    assert ("fusion_emitters" in numerics()["XLA_FLAGS"]) == known
    assert "--xla_cpu_multi_thread_eigen=false" in numerics()["XLA_FLAGS"]
