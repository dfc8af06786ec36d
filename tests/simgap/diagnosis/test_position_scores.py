"""Errors of positions: of the bodies whose positions are measured."""

import numpy as np

from simgap.diagnosis.validation.scores import HORIZONS, Judged, scores
from simgap.ground.machines import PAIR, PAIR_LEFT
from simgap.layout import Layout


def test_a_body_whose_position_is_not_measured_has_no_error_of_its_position() -> None:
    rng = np.random.default_rng(0)
    for machine, bodies in ((PAIR, ("left", "right")), (PAIR_LEFT, ("left",))):
        error = rng.standard_normal((6, len(HORIZONS), len(machine.schema.outputs)))
        judged = Judged(error, np.ones_like(error), np.zeros(6), np.arange(6))
        table = scores(Layout(machine.schema), judged, np.random.default_rng(1))
        of_positions = [name for name in table if name.endswith("[m]")]
        assert of_positions == [f"error_{HORIZONS[-1]}_{body} [m]" for body in bodies]
