"""A simulator with all effects of the catalogue at all their sites; with all constants zero it is the simulator.

Laws whose constants are zero are nil, and yet take their time. `active` says which effects act at all, so that the
others cost nothing to run. It must be the same for all that is computed side by side, for under `vmap` a condition that
differs computes both branches. `lean` leaves the others out, so that they cost nothing to compile either.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from simgap.effects import CATALOGUE
from simgap.effects.effect import Effect, Site
from simgap.effects.engine_terms import effects_of
from simgap.engines import Engine, is_engine
from simgap.layout import Layout
from simgap.types import StepModel

Theta = Float[Array | np.ndarray, " P"]
"""Internal constants of all effects at all sites; numpy's where they are known before any tracing."""

Active = Bool[Array, " effects"] | None
"""Which effects of the catalogue act; None: all do."""


class Slot(NamedTuple):
    """One constant of one effect at one site: a place in the vector theta."""

    effect: int  # in the catalogue
    constant: int
    site: int


@dataclass(frozen=True)
class Augmented:
    """`simulator` with theta, a vector of the internal constants of all effects at all sites; nil at zero.

    only: the effects (indices in the catalogue) that it has laws for; None: all, each switched by `active`.
    """

    simulator: StepModel | Engine
    only: tuple[int, ...] | None = None

    @cached_property
    def catalogue(self) -> tuple[Effect, ...]:
        """The effects that this simulator may lack; what an engine can express it expresses itself."""
        if not is_engine(self.simulator):
            return CATALOGUE
        own = effects_of(self.simulator)
        others = {effect.id for effect in own}
        return (*(e for e in CATALOGUE if e.id not in others and not e.coarse), *own)

    @cached_property
    def layout(self) -> Layout:
        return Layout(self.simulator.schema)

    @cached_property
    def sites(self) -> tuple[tuple[Site, ...], ...]:
        """Sites of every effect of the catalogue; none where it does not apply to this simulator."""
        return tuple(effect.sites(self.layout) for effect in self.catalogue)

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """What each entry of theta is."""
        return tuple(
            Slot(e, k, s)
            for e, effect in enumerate(self.catalogue)
            for k in range(len(effect.constants))
            for s in range(len(self.sites[e]))
        )

    @cached_property
    def index(self) -> dict[Slot, int]:
        """Where each constant stands in theta."""
        return {slot: i for i, slot in enumerate(self.slots)}

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest internal values of theta."""
        constants = [self.catalogue[slot.effect].constants[slot.constant] for slot in self.slots]
        return np.array([c.low for c in constants]), np.array([c.high for c in constants])

    @cached_property
    def ranges(self) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Least and greatest values of the parameters in 32 bits: none lies outside the range that is declared."""
        low, high = np.array([(p.low, p.high) for p in self.simulator.parameters], float).reshape(-1, 2).T
        least, most = low.astype(np.float32), high.astype(np.float32)
        least = np.where(least < low, np.nextafter(least, np.float32(np.inf)), least)
        most = np.where(most > high, np.nextafter(most, np.float32(-np.inf)), most)
        return least, np.maximum(least, most)

    @cached_property
    def nominal(self) -> Float[np.ndarray, " p"]:
        """The parameters that the simulator is used with as it is."""
        values = [(p.low + p.high) / 2 if p.nominal is None else p.nominal for p in self.simulator.parameters]
        return np.clip(np.array(values, np.float32), *self.ranges)

    @cached_property
    def effect_of(self) -> np.ndarray:
        """Index in the catalogue of the effect that each entry of theta belongs to."""
        return np.array([slot.effect for slot in self.slots], int)

    def lean(self, few: int, *thetas: Float[np.ndarray, "... P"]) -> "Augmented":
        """A simulator with only the laws that have a constant other than zero in any of these; itself, where these
        are more than a few. Each combination of effects is compiled anew, so this pays where few combinations occur."""
        on = np.any(np.concatenate([theta.reshape(-1, len(self.slots)) for theta in thetas]) != 0, axis=0)
        acting = tuple(np.unique(self.effect_of[on]).tolist())
        return self if len(acting) > few else _with_laws(self.simulator, acting)

    def active(self, *thetas: Float[Array | np.ndarray, " P"]) -> Active:
        """The effects that have a constant other than zero in any of these."""
        if self.only is not None:
            return None
        on = jnp.any(jnp.stack([jnp.asarray(theta) for theta in thetas]) != 0, axis=0)
        return jnp.zeros(len(self.catalogue), bool).at[self.effect_of].max(on)

    def laws(self, theta: Theta, active: Active, *places: str) -> list["Law"]:
        """The effects of some places that have sites.

        Where theta is numpy's, effects whose constants are all zero are left out: they are nil.
        """
        found, start, known = [], 0, isinstance(theta, np.ndarray)
        for i, (effect, sites) in enumerate(zip(self.catalogue, self.sites, strict=True)):
            size = len(effect.constants) * len(sites)
            c = theta[start : start + size].reshape(len(effect.constants), len(sites))
            left_out = self.only is not None and i not in self.only
            if sites and effect.place in places and not left_out and not (known and not c.any()):
                found.append(Law(effect, jnp.asarray(c), None if active is None else active[i]))
            start += size
        return found


@lru_cache(maxsize=256)
def _with_laws(simulator: StepModel | Engine, only: tuple[int, ...]) -> Augmented:
    return Augmented(simulator, only)


class Law(NamedTuple):
    """An effect with its constants; `on`: whether it acts, None for yes."""

    effect: Effect
    c: Float[Array, "k sites"]
    on: Bool[Array, ""] | None

    def __call__(self, nil: Any, *args: Any) -> Any:
        """What the law makes of its arguments, `nil` where it does not act."""
        return where(self.on, lambda: self.effect.law(self.c, *args), nil)


def where(on: Bool[Array, ""] | None, value: Callable[[], Any], nil: Any) -> Any:
    """The value where it is on, computed only there; `nil`, of the same shapes, elsewhere."""
    return value() if on is None else jax.lax.cond(on, value, lambda: nil)
