"""The catalogue of effects, physics that a simulator may lack: one physical family per file, all in `CATALOGUE`."""

from simgap.effects import (
    command_path,
    coupling,
    dry_friction,
    forces,
    hysteresis,
    limits,
    resistance,
    restoring,
    sensing,
    stops,
    timing,
    tyres,
)
from simgap.effects.effect import Effect

CATALOGUE: tuple[Effect, ...] = (
    *command_path.EFFECTS,
    *timing.EFFECTS,
    *dry_friction.EFFECTS,
    *hysteresis.EFFECTS,
    *resistance.EFFECTS,
    *tyres.EFFECTS,
    *forces.EFFECTS,
    *restoring.EFFECTS,
    *coupling.EFFECTS,
    *limits.EFFECTS,
    *stops.EFFECTS,
    *sensing.EFFECTS,
)
"""Laws of the mean, in the order in which they act at each place."""
