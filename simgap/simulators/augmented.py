"""A simulator with the effects that a diagnosis found; it can replace the simulator anywhere."""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.effects.augmented import Augmented
from simgap.effects.effect import HISTORY_ROWS, SENSED_ROWS, Earlier, Place, Row, Scales
from simgap.effects.regime import Acting, Regime, holds
from simgap.effects.step import advance, fading, remember, sense, unsense
from simgap.recordings import HISTORY
from simgap.types import Parameter, Schema, Simulator

SETTLING = 16
"""Rows for which the oldest known command is taken to have been sent before, where play or lags remember it; and for
which the bodies are taken to have moved as they do, for hysteresis."""


@dataclass(frozen=True)
class AugmentedSimulator:
    """`simulator` with known, fixed internal constants of all effects at all sites; as a `Simulator`.

    theta holds everywhere; in each of `regimes` a row of `delta` is added. frozen_scales: the `Scales` of the
    recordings in which the constants were found and to which they refer, as tuples, so that they can be hashed.

    States have their signs, also those whose sensor loses it. Delays of outputs are not inverted, as one state does not
    say how fast it was reached. The inputs of a learning problem hold no session time; the middle of the longest
    session is used.
    """

    simulator: Simulator
    theta: tuple[float, ...]
    delta: tuple[tuple[float, ...], ...]
    regimes: tuple[Regime, ...]
    frozen_scales: tuple[Any, ...]

    @staticmethod
    def of(simulator: Simulator, acting: Acting, scales: Scales) -> "AugmentedSimulator":
        """From the arrays of a diagnosis. ValueError where their number of constants is not the simulator's."""
        expected = len(Augmented(simulator).slots)
        for values in (acting.theta, *acting.delta):
            if np.shape(values) != (expected,):
                raise ValueError(
                    f"theta has shape {np.shape(values)}; this simulator's effects have {expected} constants."
                )
        theta, *delta = (tuple(map(float, np.asarray(v, np.float32))) for v in (acting.theta, *acting.delta))
        return AugmentedSimulator(simulator, theta, tuple(delta), acting.regimes, tuple(_frozen(s) for s in scales))

    @property
    def schema(self) -> Schema:
        """The simulator's own."""
        return self.simulator.schema

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The simulator's own."""
        return self.simulator.parameters

    @property
    def time_step(self) -> float:
        """The simulator's own [s]."""
        return self.simulator.time_step

    @cached_property
    def augmented(self) -> Augmented:
        """The simulator with all effects, whose constants are in `acting`."""
        return Augmented(self.simulator)

    @cached_property
    def acting(self) -> Acting:
        """The constants as numpy arrays, so that laws whose constants are all zero are never traced."""
        theta = np.asarray(self.theta, np.float32)
        return Acting(theta, np.asarray(self.delta, np.float32).reshape(-1, len(theta)), self.regimes)

    @cached_property
    def scales(self) -> Scales:
        """The magnitudes that the constants refer to."""
        return Scales(*(np.asarray(s) if isinstance(s, tuple) else s for s in self.frozen_scales))  # type: ignore[arg-type]

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of its effects."""
        each = (self.acting.theta, *self.acting.delta)
        found = (law.effect.id for theta in each for law in self.augmented.laws(theta, None, *get_args(Place)))
        return tuple(dict.fromkeys(found))

    def step(
        self, params: Float[Array, " p"], state: Float[Array, " s"], command: Float[Array, " u"]
    ) -> Float[Array, " s"]:
        """The next state, as if this command had been sent all along."""
        return self.step_from_history(params, state, jnp.tile(command, (HISTORY + 1, 1)))

    def step_from_history(
        self, params: Float[Array, " p"], state: Float[Array, " s"], commands: Float[Array, "3 u"]
    ) -> Float[Array, " s"]:
        """The next state given u_{t-2}, u_{t-1}, u_t, as if u_{t-2} had been sent all along before."""
        step = partial(self._step, params=params, state=state, commands=commands)
        # Constants stay numpy arrays, as laws whose constants are known to be zero are not traced. So there is one
        # step for each combination of regimes, of which there are few.
        ways = [(self.acting.theta, jnp.array(True))]
        for regime, delta in zip(self.regimes, self.acting.delta, strict=True):
            there = holds(self.augmented.layout, regime, state, commands[-1])
            ways += [(theta + delta, holding & there) for theta, holding in ways]
        after = step(ways[0][0])
        for theta, holding in ways[1:]:
            after = jnp.where(holding, step(theta), after)
        return after

    def _step(
        self,
        theta: Float[np.ndarray, " P"],
        params: Float[Array, " p"],
        state: Float[Array, " s"],
        commands: Float[Array, "3 u"],
    ) -> Float[Array, " s"]:
        augmented = self.augmented
        remembers = bool(augmented.laws(theta, None, "filter"))
        earlier = jnp.tile(commands[0], (HISTORY_ROWS - HISTORY + 1 + remembers * SETTLING, 1))
        past = jnp.concatenate([commands[HISTORY - 1 :: -1], earlier])
        row = Row(jnp.asarray(self.scales.duration / 2), jnp.ones(()))
        start = unsense(augmented, theta, state, row.time_s)
        rates = augmented.layout.integrates
        moved = jnp.where(rates >= 0, SETTLING * self.time_step * start[rates], 0.0)
        forgets, earlier = fading(augmented, params, theta), Earlier(past, states=(start - moved)[None])
        memory = remember(augmented, forgets, theta, start, earlier, row.time_s)
        memory, then = advance(augmented, params, theta, self.scales, memory, start, commands[-1], row)
        at_rest = memory._replace(states=jnp.tile(then, (SENSED_ROWS, 1)))
        # The next step needs the sign.
        return sense(augmented, np.where(augmented.folding, 0.0, theta), at_rest, then, row)

    def to_body(self, state: Float[Array, " s"]) -> Float[Array, " s"]:
        """The simulator's own."""
        return self.simulator.to_body(state)

    def from_body(self, body: Float[Array, " s"]) -> Float[Array, " s"]:
        """The simulator's own."""
        return self.simulator.from_body(body)


def _frozen(values: Any) -> Any:
    """An array as nested tuples, a number as it is."""
    if isinstance(values, np.ndarray | list):
        return tuple(_frozen(v) for v in (values.tolist() if isinstance(values, np.ndarray) else values))
    return float(values)
