"""Commands that excite a machine of the training ground."""

import numpy as np
from jaxtyping import Float


def drawn_commands(channels: int, rng: np.random.Generator, rows: int) -> Float[np.ndarray, "T u"]:
    """Steps, waves or slow noise for every channel, of a size near one."""
    t = np.arange(rows)
    columns = []
    for _ in range(channels):
        manner = rng.integers(3)
        if manner == 0:
            lasts = rng.integers(8, 30)
            columns.append(np.repeat(rng.uniform(-1.2, 1.2, rows // lasts + 1), lasts)[:rows])
        elif manner == 1:
            periods, phases = np.exp(rng.uniform(np.log(8), np.log(120), 3)), rng.uniform(0, 2 * np.pi, 3)
            columns.append(0.7 * np.sin(2 * np.pi * t[:, None] / periods + phases).sum(1))
        else:
            kept = np.exp(-1 / rng.uniform(5, 30))
            wander = np.zeros(rows)
            for k in range(1, rows):
                wander[k] = kept * wander[k - 1] + np.sqrt(1 - kept**2) * rng.standard_normal()
            columns.append(0.8 * wander)
    return np.stack(columns, axis=1)
