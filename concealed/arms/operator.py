"""Who commands an arm: moves, steps, waves and pauses of every joint, each by itself."""

import numpy as np

from concealed.form import Array

KINDS, ODDS = ("hold", "step", "move", "wave"), (0.15, 0.25, 0.35, 0.25)
HOME = np.array([0.0, -0.5, 0.3, 0.0, 0.2, 0.0])
"""Angles about which an arm is used [rad]: raised, the elbow bent."""
ROAM = np.array([0.7, 0.4, 0.5, 0.6, 0.6, 0.6])
"""How far a session's own home may be from there, and joints from that [rad]."""


def commands(joints: int, rows: int, interval: float, rng: np.random.Generator) -> Array:
    """Joint angles [rows, joints] to be sent every `interval` [s], in radians."""
    home = HOME[:joints] + ROAM[:joints] * rng.uniform(-0.7, 0.7, joints)
    sent = np.empty((rows, joints))
    for j in range(joints):
        row, angle = 0, 0.0
        while row < rows:
            lasts = max(2, round(rng.uniform(0.4, 2.0) / interval))
            time = np.arange(1, lasts + 1) / lasts
            to = ROAM[j] * rng.uniform(-0.7, 0.7)
            match str(rng.choice(KINDS, p=ODDS)):
                case "hold":
                    path = np.full(lasts, angle)
                case "step":
                    path = np.full(lasts, to)
                case "move":
                    path = angle + (to - angle) * (10 * time**3 - 15 * time**4 + 6 * time**5)
                case _:
                    hertz = np.exp(rng.uniform(np.log(0.4), np.log(3.0)))
                    size = 0.5 * ROAM[j] * rng.uniform(0.3, 1.0) / max(1.0, hertz)
                    path = angle + size * np.sin(2 * np.pi * hertz * interval * np.arange(1, lasts + 1))
            path = path[: rows - row]
            sent[row : row + len(path), j] = path
            row, angle = row + len(path), float(path[-1])
    return np.round(home + sent, 4)
