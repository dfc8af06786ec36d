"""Diagnosed effects and the simulators that have them, as named arrays."""

import numpy as np

from simgap.effects.effect import Scales
from simgap.effects.regime import Acting, Regime
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import Spot

SCALES = "scales_"


def augmented_arrays(simulator: AugmentedSimulator) -> dict[str, np.ndarray]:
    """The effects' constants, their scales (`scales_<name>`) and the time step [s], as `augmented_spot` reads them."""
    return {**acting_arrays(simulator.acting), "time_step": np.asarray(simulator.time_step, np.float64),
            **scale_arrays(simulator.scales)}  # fmt: skip


def augmented_spot(arrays: dict[str, np.ndarray]) -> AugmentedSimulator:
    """The Spot with effects that `augmented_arrays` wrote; removes its arrays. KeyError if one is missing."""
    scales, spot = pop_scales(arrays), Spot(time_step=float(arrays.pop("time_step")))
    return AugmentedSimulator.of(spot, pop_acting(arrays), scales)


def acting_arrays(acting: Acting) -> dict[str, np.ndarray]:
    """Effects' constants and the regimes in which they differ, as `pop_acting` reads them."""
    return {name: np.asarray(value) for name, value in acting._asdict().items()}


def pop_acting(arrays: dict[str, np.ndarray]) -> Acting:
    """The constants among `arrays`, from which they are removed; KeyError if one is missing."""
    theta, delta, regimes = (arrays.pop(name) for name in Acting._fields)
    return Acting(theta, delta, tuple(Regime(int(f), float(side), float(edge)) for f, side, edge in regimes))


def scale_arrays(scales: Scales) -> dict[str, np.ndarray]:
    """The scales that effects' constants refer to, as `pop_scales` reads them."""
    return {f"{SCALES}{name}": np.asarray(value) for name, value in scales._asdict().items()}


def pop_scales(arrays: dict[str, np.ndarray]) -> Scales:
    """The scales among `arrays`, from which they are removed; KeyError if one is missing that has no default."""
    names = [name for name in Scales._fields if f"{SCALES}{name}" in arrays or name not in Scales._field_defaults]
    scales = {name: arrays.pop(f"{SCALES}{name}") for name in names}
    return Scales(**{name: float(v) if v.ndim == 0 else v for name, v in scales.items()})  # type: ignore[arg-type]
