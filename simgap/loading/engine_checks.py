"""Checks an engine: its terms, the shape of its rows, and that rows repeat and do not depend on each other."""

import numpy as np
from jaxtyping import Float

from simgap.engines import Engine, Term, no_effort
from simgap.loading.user_code import RAISED, check_tuple, reason, shown
from simgap.types import ConfigError, Field

_TYPICAL = {"position": 0.3, "angle": 0.3, "velocity": 0.2, "force": 1.0}


def check_rows(engine: Engine, name: str) -> None:
    """ConfigError that begins with `name` unless the engine's states, parts, terms and rows are as `Engine` has them.

    Rows are tried at nominal parameters, with all states and commands zero and with typical ones.
    """
    observed = [f.observed for f in engine.schema.state]
    if sorted(observed, reverse=True) != observed or not observed[0]:
        raise ConfigError(f"{name}: states that recordings lack (observed=False) must come last in schema.state, after "
                          "at least one that they have. Change the order.")  # fmt: skip
    if not isinstance(engine.parts, int) or engine.parts < 1:
        raise ConfigError(f"{name}: parts must be a whole number from 1 on; it is {shown(engine.parts)}. Write 1 where "
                          "a command is held for a whole row.")  # fmt: skip
    check_tuple(engine.terms, Term, "Term(...)", "terms", name)
    for term in engine.terms:
        if not (
            np.isfinite(term.low) and term.low < term.high and any(term.low <= s <= term.high for s in term.starts)
        ):
            raise ConfigError(f"{name}: term {term.effect} on {term.where}: low < high must be finite, with one of the "
                              f"starts between; they are {term.low}, {term.high} and {term.starts}.")  # fmt: skip
    _try(engine, name)


def _try(engine: Engine, name: str) -> None:
    phi = np.array([(p.low + p.high) / 2 if p.nominal is None else p.nominal for p in engine.parameters], float)
    state = np.vstack([np.zeros(len(engine.schema.state)), _typical(engine.schema.state)])
    command = np.repeat(np.vstack([np.zeros(len(engine.schema.command)), _typical(engine.schema.command)])[:, None],
                        engine.parts, axis=1)  # fmt: skip
    terms, effort = np.zeros((2, len(engine.terms))), no_effort(engine, 2)

    def rows(index: list[int]) -> Float[np.ndarray, "n s"]:
        return np.asarray(engine.rows(phi, terms[index], state[index], command[index], effort[index]))

    try:
        both, turned, alone = rows([0, 1]), rows([1, 0]), rows([1])
    except RAISED as error:
        raise ConfigError(f"{name}: rows must run on states {state.shape}, commands {command.shape}, terms "
                          f"{terms.shape} and efforts {effort.shape}; it gave {reason(error)}. Mend "
                          "rows.") from None  # fmt: skip
    if both.shape != state.shape or both.dtype != np.float64:
        raise ConfigError(f"{name}: rows must return the next states, shape {state.shape} in double precision; it "
                          f"returned shape {both.shape} of {both.dtype}. Return a row for each row given.")  # fmt: skip
    if not np.isfinite(both).all():
        raise ConfigError(f"{name}: rows must be finite at nominal parameters, with all states and commands zero and "
                          f"with typical ones ({state[1].tolist()}). Look for a division by zero.")  # fmt: skip
    if not (np.allclose(both, turned[::-1], rtol=0, atol=1e-12) and np.allclose(both[1:], alone, rtol=0, atol=1e-12)):
        raise ConfigError(f"{name}: a row must not depend on the other rows of a call or on earlier calls; in "
                          "another order they differ. Set the whole state before each row, also what the engine "
                          "remembers.")  # fmt: skip


def _typical(fields: tuple[Field, ...]) -> list[float]:
    """Typical values, all different."""
    return [_TYPICAL[f.kind] * (1 + 0.1 * i) for i, f in enumerate(fields)]
