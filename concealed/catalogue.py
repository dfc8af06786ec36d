"""All concealed forms by their id, and those that have none."""

from collections.abc import Callable, Sequence

import numpy as np

from concealed.form import Form
from concealed.forms import arm, command_dynamics, gains, ground, measuring, nonlinearities, outside

Make = Callable[[np.random.Generator], Form]


def _plain(form: type[Form]) -> Make:
    return lambda _: form()


FORMS: dict[str, tuple[Make, ...]] = {
    "delay": (command_dynamics.Delay,),
    "lag": (command_dynamics.Lag,),
    "rate_limit": (command_dynamics.RateLimit,),
    "saturation": (nonlinearities.Saturation,),
    "deadband": (nonlinearities.Deadband,),
    "backlash": (nonlinearities.Backlash,),
    "quantization": (nonlinearities.Quantization,),
    "gain": (gains.Gain,),
    "asymmetric_gain": (gains.AsymmetricGain,),
    "gain_drift": (gains.GainDrift,),
    "dropout": (command_dynamics.Dropout,),
    "coulomb_friction": (ground.StickSlip,),
    "viscous_drag": (ground.Viscous,),
    "quadratic_drag": (ground.Quadratic,),
    "gravity_sag": (_plain(arm.Sag),),
    "payload": (arm.Payload,),
    "arm_base_coupling": (_plain(arm.Reaction),),
    "base_arm_coupling": (_plain(arm.Dragged),),
    "cross_axis_coupling": (gains.CrossAxis,),
    "rotation_centre": (ground.OffCentre,),
    "centripetal": (_plain(arm.Thrown),),
    "slip": (_plain(ground.Slip),),
    "slope": (ground.Slope,),
    "body_frame_bias": (ground.Crab,),
    "external_push": (ground.Push,),
    "reach_limit": (_plain(arm.ReachEnd),),
    "ground_contact": (arm.Floor,),
    "gait_oscillation": (ground.Gait,),
    "relative_smoothing": (_plain(arm.OwnMemory), _plain(arm.BodyMemory)),
    "frame_misalignment": (gains.Misaligned,),
    "sampling_interval": (_plain(measuring.Stalls),),
    "integration_rule": (_plain(measuring.OldVelocity),),
    "motion_dependent_noise": (measuring.Shaking,),
    "sensor_delay": (measuring.LateSensor,),
    "sensor_bias": (measuring.Drifting, measuring.TurnedCompass),
    "sensor_scale": (measuring.Scaled,),
}
"""Every id of the vocabulary, in its physical forms."""

OUTSIDE: dict[str, Make] = {
    "magnet": outside.Attracted,
    "lift_turns_base": _plain(outside.LiftTurns),
    "corrugated_floor": outside.Corrugated,
    "wind_up": _plain(outside.WindUp),
    "elastic_arm": outside.Elastic,
    "carpet_grain": outside.Carpet,
    "top_heavy": _plain(outside.TopHeavy),
    "gusts": _plain(outside.Gusts),
    "ratchet": _plain(outside.Ratchet),
}


def make(name: str, rng: np.random.Generator) -> Form:
    """A form of an id, or of a law without one, drawn with all that is fixed of it."""
    kinds = FORMS[name] if name in FORMS else (OUTSIDE[name],)
    return kinds[int(rng.integers(len(kinds)))](rng)


HARDER = {
    "Delay": {"jitter": 0.3},
    "Dropout": {"shortest": 0.1, "longest": 1.9},
    "Floor": {"uneven": 0.02},
    "LateSensor": {"jitter": 0.3},
    "Slope": {"uneven": 0.6},
    "Stalls": {"share": 0.12},
    "StickSlip": {"hold": 1.6},
}
"""Other forms of the same effects, for examinations."""


def make_all(names: Sequence[str], harder: bool, rng: np.random.Generator) -> list[Form]:
    """The forms of several ids, in their harder variants if asked for."""
    forms = [make(name, rng) for name in names]
    if harder:
        for form in forms:
            for name, value in HARDER.get(type(form).__name__, {}).items():
                setattr(form, name, value)
    return forms
