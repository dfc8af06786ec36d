"""Of a black box, the part is judged that foretells best, and none of it where all of it does harm."""

import jax.numpy as jnp
import numpy as np
from planted import PHI
from small import problem, sessions

from simgap.diagnosis import black_box
from simgap.diagnosis.fit import evaluate, start, whitening
from simgap.diagnosis.forecast import windows
from simgap.diagnosis.judge import STRIDE, Contestant, one_step


def test_a_box_that_does_harm_foretells_worse_than_none_of_it() -> None:
    training, _ = sessions({})
    of = problem(training)
    v = start(of)._replace(phi=jnp.asarray(PHI))
    of = of._replace(whiten=whitening(evaluate(of, v, ()).e))
    rows = windows(training, 1 / 15, 1, STRIDE)
    assert rows is not None
    silent = black_box.silent(of.augmented.layout)
    rng = np.random.default_rng(0)
    harmful = silent._replace(weights=jnp.asarray(0.1 * rng.normal(size=silent.weights.shape), jnp.float32))
    foretold = [one_step(of, Contestant(v, black_box.in_part(harmful, share)), rows) for share in (1.0, 0.25, 0.0)]
    assert foretold == sorted(foretold)
    assert foretold[-1] == one_step(of, Contestant(v), rows)
    assert one_step(of, Contestant(v, black_box.in_part(harmful, 1e38)), rows) == -np.inf
