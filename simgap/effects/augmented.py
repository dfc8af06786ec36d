"""A simulator with all effects of the catalogue at all their sites; with all constants zero it is the simulator itself.

A law whose constants are zero changes nothing, but still takes time. `active` says which effects act, so that the
others cost no run time. It must be the same for everything that is computed in one batch: under `vmap`, a condition
that differs between members computes both branches. `lean` leaves the other laws out, which saves compile time as well.
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
"""Internal constants of all effects at all sites. A numpy array where they are known before tracing."""

Active = tuple[Bool[Array, ""], ...] | None
"""Which effects of the catalogue act; None: all. Numbers, not an array, which XLA would take apart in every row."""


class Slot(NamedTuple):
    """One constant of one effect at one site: one entry of the vector theta."""

    effect: int  # index in the catalogue
    constant: int
    site: int


@dataclass(frozen=True)
class Augmented:
    """`simulator` with theta, the vector of the internal constants of all effects at all sites. At zero, none acts.

    only: indices in the catalogue of the effects whose laws it has. None: it has all, each switched by `active`.
    """

    simulator: StepModel | Engine
    only: tuple[int, ...] | None = None

    @cached_property
    def catalogue(self) -> tuple[Effect, ...]:
        """The effects that this simulator may lack.

        For an engine, its own terms replace the effects with the same id (of one form, if the term has one), and
        `coarse` effects are left out.
        """
        if not is_engine(self.simulator):
            return CATALOGUE
        own = effects_of(self.simulator)
        replaced = {effect.key for effect in own}
        return (*(e for e in CATALOGUE if not {e.id, e.key} & replaced and not e.coarse), *own)

    @cached_property
    def layout(self) -> Layout:
        return Layout(self.simulator.schema)

    @cached_property
    def sites(self) -> tuple[tuple[Site, ...], ...]:
        """Sites of every effect of the catalogue; empty where the effect does not apply to this simulator."""
        return tuple(effect.sites(self.layout) for effect in self.catalogue)

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Effect, constant and site of each entry of theta."""
        return tuple(
            Slot(e, k, s)
            for e, effect in enumerate(self.catalogue)
            for k in range(len(effect.constants))
            for s in range(len(self.sites[e]))
        )

    @cached_property
    def index(self) -> dict[Slot, int]:
        """Index in theta of each constant."""
        return {slot: i for i, slot in enumerate(self.slots)}

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of theta."""
        constants = [self.catalogue[slot.effect].constants[slot.constant] for slot in self.slots]
        return np.array([c.low for c in constants]), np.array([c.high for c in constants])

    @cached_property
    def ranges(self) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Lower and upper bounds of the parameters in 32 bits, rounded so that none lies outside the declared range."""
        low, high = np.array([(p.low, p.high) for p in self.simulator.parameters], float).reshape(-1, 2).T
        least, most = low.astype(np.float32), high.astype(np.float32)
        least = np.where(least < low, np.nextafter(least, np.float32(np.inf)), least)
        most = np.where(most > high, np.nextafter(most, np.float32(-np.inf)), most)
        return least, np.maximum(least, most)

    @cached_property
    def nominal(self) -> Float[np.ndarray, " p"]:
        """Nominal parameters; the middle of the range where no nominal value is declared."""
        values = [(p.low + p.high) / 2 if p.nominal is None else p.nominal for p in self.simulator.parameters]
        return np.clip(np.array(values, np.float32), *self.ranges)

    @cached_property
    def effect_of(self) -> np.ndarray:
        """Index in the catalogue of the effect of each entry of theta."""
        return np.array([slot.effect for slot in self.slots], int)

    @cached_property
    def folding(self) -> Bool[np.ndarray, " P"]:
        """Which entries of theta are constants of an effect that folds."""
        return np.array([self.catalogue[slot.effect].folds for slot in self.slots], bool)

    def lean(self, few: int, *thetas: Float[np.ndarray, "... P"]) -> "Augmented":
        """A simulator with only the laws that have a nonzero constant in any of `thetas`; itself if more than `few` do.

        Each combination of effects is compiled anew, so this pays off where few combinations occur.
        """
        on = np.any(np.concatenate([theta.reshape(-1, len(self.slots)) for theta in thetas]) != 0, axis=0)
        acting = tuple(np.unique(self.effect_of[on]).tolist())
        return self if len(acting) > few else _with_laws(self.simulator, acting)

    def active(self, *thetas: Float[Array | np.ndarray, " P"]) -> Active:
        """Which effects have a nonzero constant in any of `thetas`; None for a lean simulator, whose laws all act."""
        if self.only is not None:
            return None
        on = jnp.any(jnp.stack([jnp.asarray(theta) for theta in thetas]) != 0, axis=0)
        return tuple(jnp.zeros(len(self.catalogue), bool).at[self.effect_of].max(on))

    def laws(self, theta: Theta, active: Active, *places: str) -> list["Law"]:
        """The laws of these places that have sites, each with its constants.

        Where theta is a numpy array, laws whose constants are all zero are left out.
        """
        found, start, known = [], 0, isinstance(theta, np.ndarray)
        for i, (effect, sites) in enumerate(zip(self.catalogue, self.sites, strict=True)):
            own = slice(start, start + len(effect.constants) * len(sites))
            left_out = self.only is not None and i not in self.only
            if sites and effect.place in places and not left_out and not (known and not theta[own].any()):
                on = None if active is None or effect.slight else active[i]
                found.append(Law(effect, theta, own, on))
            start = own.stop
        return found


@lru_cache(maxsize=256)
def _with_laws(simulator: StepModel | Engine, only: tuple[int, ...]) -> Augmented:
    return Augmented(simulator, only)


class Law(NamedTuple):
    """An effect with its constants, which are a slice of theta. `on`: whether it acts; None: it is computed, whether or
    not it does."""

    effect: Effect
    theta: Theta
    own: slice
    on: Bool[Array, ""] | None

    @property
    def c(self) -> Float[Array, "k sites"]:
        """Cut out only where the law is computed: XLA would otherwise do so in every row for all laws."""
        return jnp.asarray(self.theta[self.own]).reshape(len(self.effect.constants), -1)

    def __call__(self, nil: Any, *args: Any) -> Any:
        """Apply the law to its arguments; returns `nil` if it is off."""
        return where(self.on, lambda: self.effect.law(self.c, *args), nil)


def where(on: Bool[Array, ""] | None, value: Callable[[], Any], nil: Any) -> Any:
    """Return `value()` if `on` is true or None, else `nil` of the same shapes; `value` runs only if it is needed."""
    return value() if on is None else jax.lax.cond(on, value, lambda: nil)
