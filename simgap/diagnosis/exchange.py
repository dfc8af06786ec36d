"""Held-out sessions are recordings too: what they alone show is not to be missed."""

import numpy as np

from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.model import Reporter
from simgap.diagnosis.inference.passes import explained
from simgap.diagnosis.report.names import listed, title
from simgap.diagnosis.validation.heldout_only import heldout_only
from simgap.engines import Engine
from simgap.types import Sessions, StepModel


def exchanged(sessions: Sessions) -> Sessions:
    """The held-out sessions fitted, and as many of those that were fitted, at equal distances, held out instead."""
    training, heldout = sessions.training, sessions.heldout
    held = set(np.linspace(0, len(training) - 1, min(len(heldout), len(training))).round().astype(int).tolist())
    kept = [r for i, r in enumerate(training) if i not in held]
    return sessions._replace(training=[*kept, *heldout], heldout=[training[i] for i in sorted(held)])


def explained_or_exchanged(
    simulator: StepModel | Engine, given: Sessions, rng: np.random.Generator, report: Reporter
) -> tuple[Explanation, Sessions, list[str]]:
    """The explanation of the fitted sessions, all sessions, and notes.

    If the fitted sessions show nothing, but held-out ones do, these are fitted and others held out, where that may be
    done. Arguments and errors as in `diagnose`.
    """
    found, sessions = explained(simulator, given, rng, report)
    elsewhere = heldout_only(found, rng.spawn(1)[0])
    if elsewhere is None:
        return found, sessions, []
    found = found._replace(elsewhere=elsewhere)
    if not given.exchangeable:
        return found, sessions, []
    like = f"{title(elsewhere.hypothesis.effect.id)} on {elsewhere.hypothesis.where}"
    report(f"held-out sessions show something, most like {like}: they are fitted, and others are held out")
    swapped = exchanged(given)
    again, after = explained(simulator, swapped, rng, report)
    if not again.anything:
        return found, sessions, []
    first, then = (listed([r.name for r in part.heldout]) for part in (given, swapped))
    note = (
        f"At first {first} were held out. They show what the others hardly do, most like {like}, so they are fitted, "
    )
    return again, after, [f"{note}and {then} are held out instead."]
