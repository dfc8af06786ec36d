"""How much of a cause could be seen: what a filter that knows it gains over one that does not, on held-out sessions."""

import numpy as np

from concealed.form import Array
from concealed.kinds.robots import Kind
from concealed.kinds.session import PLAIN, Recorded, Traits, row, shown, wrapped
from concealed.sessions import every_fourth

NEAR = 1e-5
"""Step of the differences by which a row is linearised."""
FIRM = 1e-12
"""Least variance of what disturbs a state in a row."""


def strength(of: Kind, p: Array, traits: Traits, recorded: Recorded, level: float) -> float:
    """The gain [nats] of an extended Kalman filter with the true traits over one without, both with the true parameters
    and variances of the noise, on every fourth session. No parameter is refitted to hide the cause."""
    some = every_fourth(recorded.measured.shape[1])
    seen = Recorded(*(a[:, some] for a in recorded))
    return _density(of, p, traits, seen, level) - _density(of, p, PLAIN, seen, level)


def _density(of: Kind, p: Array, traits: Traits, recorded: Recorded, level: float) -> float:
    """Log-likelihood of what was measured, but for a constant."""
    y, sent = recorded
    rows, batch, states = y.shape
    noise, shaken = (np.diag(level**2 * a**2) for a in (of.measured, of.disturbed))
    x, spread, total = np.zeros((rows, batch, states)), np.tile(noise, (batch, 1, 1)), 0.0
    # Every estimate, and next to it one that is off by a little in each state, are stepped at once.
    off = np.concatenate([np.zeros((1, states)), NEAR * np.eye(states)])
    commands = np.repeat(sent, states + 1, axis=1)
    x[0], lagging = y[0], commands[0]
    for t in range(1, rows):
        about = (x[t - 1][:, None] + off).reshape(-1, states)
        ahead, lagging = row(of, p, about, traits, commands[:t], lagging)
        ahead = ahead.reshape(batch, states + 1, states)
        slope = np.swapaxes(ahead[:, 1:] - ahead[:, :1], 1, 2) / NEAR
        spread = slope @ spread @ np.swapaxes(slope, 1, 2) + shaken + FIRM * np.eye(states)
        x[t] = ahead[:, 0]
        e = wrapped(of, y[t] - shown(of, traits, x[: t + 1]))
        cov = spread + noise
        weighed = np.linalg.solve(cov, e[..., None])
        total -= 0.5 * float((e[..., None] * weighed).sum() + np.linalg.slogdet(cov)[1].sum())
        x[t] += (spread @ weighed)[..., 0]
        spread = spread - spread @ np.linalg.solve(cov, spread)
    return total
