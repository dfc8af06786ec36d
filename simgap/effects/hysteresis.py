"""Hysteresis: forces that depend on how a place was reached, of bodies that keep theirs (`restoring.staying`).

`law(c[k, sites], z, way, layout) -> (z, push)`: from a bend z at the beginning of a way [s], that at its end, and the
push by its mean.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Scales
from simgap.effects.restoring import staying, staying_sites
from simgap.effects.sites import on_axes
from simgap.layout import Layout

SHORT = (0.03, 0.1, 0.3, 1.0)
"""Starting values of the length, as shares of the usual distance."""
RESOLVED, CLEAR = 0.1, 3.0
"""Least length of hysteresis, as a share of the usual way in a row (near reversals rows are shorter), and in units of
the noise or the step of a position: what builds up on a shorter way is dry friction."""
STILL = 1e-6
"""Ways below this share of the length count as none."""

_Table = Float[Array, "b 4"]
"""A value per body and axis."""


def _dahl(z: _Table, x: _Table) -> tuple[_Table, _Table]:
    """dz/dx = 1 - z sign(x): bristles give way gradually [Dahl 1968]. z at the end of a way x, and its mean there."""
    end, far = jnp.sign(x), jnp.maximum(jnp.abs(x), STILL)
    return end + (z - end) * jnp.exp(-far), end - (z - end) * jnp.expm1(-far) / far


def _elastic(z: _Table, x: _Table) -> tuple[_Table, _Table]:
    """dz/dx = 1 where the way x bends further, 1 + |z| where it bends back [Wen 1976, without softening]: a spring that
    does not give back all. z at the end of a way, and its mean there."""
    sign, far = jnp.where(x < 0, -1.0, 1.0), jnp.maximum(jnp.abs(x), STILL)
    begin = sign * z
    back = jnp.minimum(jnp.log1p(jnp.maximum(-begin, 0.0)), far)  # the part of the way that bends back
    turned = jnp.where(begin < 0, 1 + (begin - 1) * jnp.exp(-back), begin)
    on = far - back
    over = jnp.where(begin < 0, back - (begin - 1) * jnp.expm1(-back), 0.0) + (turned + on / 2) * on
    return sign * (turned + on), sign * over / far


def _maxwell(z: _Table, x: _Table) -> tuple[_Table, _Table]:
    """A spring that slides when it is bent to one [Maxwell slip]. z at the end of a way x, and its mean there."""
    end = jnp.clip(z + x, -1.0, 1.0)
    bends = end - z
    # The mean of a stretch that bends and one that slides.
    share = jnp.clip(bends / jnp.where(jnp.abs(x) > STILL, x, 1.0), 0.0, 1.0)
    return end, share * (z + end) / 2 + (1 - share) * end


_Law = Callable[[Float[Array, "2 n"], _Table, Float[Array, " s"], Layout], tuple[_Table, _Table]]


def _law(bend: Callable[[_Table, _Table], tuple[_Table, _Table]], stiff: bool = False) -> _Law:
    """-c_0 z, or where `stiff`, -c_0 c_1 z; z bends on ways in units of c_1."""

    def law(c: Float[Array, "2 n"], z: _Table, way: Float[Array, " s"], layout: Layout) -> tuple[_Table, _Table]:
        force, length = (on_axes(layout, values, staying(layout)) for values in c)
        along = on_axes(layout, [way[layout.position[place]] for place in staying(layout)], staying(layout))
        end, mean = bend(z, along / jnp.where(length > 0, length, jnp.inf))
        return end, -(force * length if stiff else force) * mean

    return law


def _end_to_end(site: int, scales: Scales) -> float:
    """With a greater length the force would not build up on the usual way: that is a spring."""
    return 2 * float(scales.travel[site])


def _resolved(site: int, scales: Scales) -> float:
    """The least length on which rows show how a force builds up."""
    return max(RESOLVED * scales.time_step * float(scales.pace[site]), CLEAR * float(scales.grain[site]))


def _usual_command(site: int, scales: Scales) -> float:
    """With a greater loss, hardly any command would move the body."""
    return float(scales.hold[site])


def _unresolved(scales: Scales, site: int) -> list[list[float]]:
    return [[0.1 * float(scales.hold[site]), share * _resolved(site, scales)] for share in (0.1, 0.5)]


def _forces(scales: Scales, site: int) -> list[list[float]]:
    return [[0.1 * float(scales.hold[site]), share * float(scales.travel[site])] for share in SHORT]


def _stiffnesses(scales: Scales, site: int) -> list[list[float]]:
    far = float(scales.travel[site])
    return [[0.1 * float(scales.hold[site]) / far, share * far] for share in SHORT]


_FORCE, _STIFFNESS = (Constant(name, unit, low=0.0) for name, unit in (("force", "{u}"), ("stiffness", "{u}/{x}")))
_LENGTH = Constant("length", "{x}", low=0.0, shapes=True, credible=_end_to_end, least=_resolved)

_LOSS = Constant("loss", "{u}", low=0.0, credible=_usual_command)
_GIVES = Constant("length", "{x}", low=0.0, shapes=True, credible=_resolved)

EFFECTS = (
    Effect(
        "coulomb_friction", "hysteresis", (_LOSS, _GIVES), staying_sites, _unresolved, _law(_maxwell),
        "dry friction: a constant resistance of {loss} works against the motion, once that has gone {length} after a "
        "reversal", form="giving", tie="same_unit", extends="coulomb_friction",
    ),
    Effect(
        "hysteresis", "hysteresis", (_FORCE, _LENGTH), staying_sites, _forces, _law(_dahl),
        "hysteresis: after a reversal a force against the motion builds up, gradually, to {force} on a way of about "
        "{length}", form="gradual", tie="same_unit", extends="coulomb_friction",
    ),
    Effect(
        "hysteresis", "hysteresis", (_FORCE, _LENGTH), staying_sites, _forces, _law(_maxwell),
        "hysteresis: after a reversal a force against the motion builds up like a spring's to {force} on a way of "
        "{length}, then slides", form="sliding", tie="same_unit", extends="coulomb_friction",
    ),
    Effect(
        "hysteresis", "hysteresis", (_STIFFNESS, _LENGTH), staying_sites, _stiffnesses, _law(_elastic, stiff=True),
        "hysteresis: a spring of {stiffness} does not give back all: on the way back its force falls faster, by as "
        "much again for every {length} that it was bent", form="elastic", tie="same_unit",
    ),
)  # fmt: skip
