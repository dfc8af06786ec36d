"""What looks wrong in a set of recordings, as sentences that say what to do."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from simgap import survey
from simgap.agreement import Following, Frame, following, frames
from simgap.derived import Derived, derived, sentence
from simgap.repeats import Repeat, repeats
from simgap.types import Recording, Schema

NAMED = 3
"""Maximum number of sessions that a finding names; the others are counted."""
TURNED, TURNED_BETTER = 0.8, 4.0
"""Velocities are in the other frame if they match it with at least this agreement, and if their disagreement (1 minus
agreement) is this many times smaller there."""
FOLLOWS, UNUSUAL = 0.7, 5.0
"""Minimum correlation of a command that is followed, and the factor between the two that cannot be a machine's gain."""
UNITS: Mapping[str, float] = {"degrees and radians": 180 / np.pi, "revolutions a minute and rad/s": 30 / np.pi,
                              "millimetres and metres": 1000, "centimetres and metres": 100}  # fmt: skip
UNIT_GAIN = 1.3
"""Largest factor by which a machine's own gain may change a factor between units: half way, as a ratio, from degrees
and radians (57) to centimetres and metres (100)."""


class Survey(NamedTuple):
    """What a set of recordings holds, by session, column, velocity and command."""

    rates: dict[str, survey.Rate]
    columns: dict[str, survey.Column]
    kinematics: dict[str, survey.Kinematics]
    excitation: dict[str, survey.Excitation]
    frames: list[Frame]
    following: dict[str, Following]
    derived: list[Derived]
    repeats: list[Repeat]


def look(schema: Schema, recordings: Sequence[Recording]) -> Survey:
    """Survey all sessions together."""
    columns = {
        field.name: survey.column(recordings, [getattr(r, part)[:, i] for r in recordings], field.kind == "angle")
        for part, fields in (("state", schema.state), ("command", schema.command))
        for i, field in enumerate(fields)
    }
    # Commands may step.
    columns |= {f.name: columns[f.name]._replace(jumps=()) for f in schema.command}
    return Survey(
        {r.name: survey.rate(r) for r in recordings}, columns, survey.kinematics(schema, recordings),
        survey.excitation(schema, recordings), frames(schema, recordings), following(schema, recordings),
        derived(schema, recordings), repeats(recordings),
    )  # fmt: skip


def findings(schema: Schema, time_step: float, found: Survey) -> list[str]:
    """One sentence for everything that looks wrong; `time_step` [s] is the simulator's."""
    return [
        *_of_rates(found.rates, time_step),
        *_of_repeats(found.repeats),
        *_of_columns(schema, found.columns),
        *_of_velocities(found),
        *_of_commands(found),
    ]


def _named(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED:,} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def _of_rates(rates: Mapping[str, survey.Rate], time_step: float) -> Iterator[str]:
    by_median = sorted(rates, key=lambda name: rates[name].median_s)
    fast, slow = rates[by_median[0]].median_s, rates[by_median[-1]].median_s
    if slow > 1.1 * fast:
        yield (f"The sessions have different rates: {by_median[0]} has {1 / fast:.4g} Hz, {by_median[-1]} "
               f"{1 / slow:.4g} Hz. A simulator has one step: import all at one rate (`simgap import`).")  # fmt: skip
    off = [name for name, r in rates.items() if abs(r.median_s / time_step - 1) > 0.1]
    if off:
        worst = max(off, key=lambda name: abs(np.log(rates[name].median_s / time_step)))
        yield (f"{_named(off)}: rows are {rates[worst].median_s:.4g} s apart, the simulator's step is {time_step:.4g} "
               "s. Resample (`simgap import`), or give the simulator that step.")  # fmt: skip
    stalled = [name for name, r in rates.items() if r.stalls > 0.01]
    if stalled:
        worst = max(stalled, key=lambda name: rates[name].stalls)
        r = rates[worst]
        yield (f"{_named(stalled)}: up to {r.stalls:.0%} of the rows last over {survey.STALL:g} times the median, in "
               f"{worst} at most {r.longest_s:.3g} s (row {r.longest_row}). Check whether the "
               "recorder stalls.")  # fmt: skip
    cut = [name for name, r in rates.items() if r.gaps]
    if cut:
        worst = max(cut, key=lambda name: rates[name].longest_s / rates[name].median_s)
        r = rates[worst]
        gaps, where = ("one gap dwarfs", "there") if r.gaps == 1 else (f"{r.gaps} gaps dwarf", "at each")
        yield (f"{_named(cut)}: {gaps} all other intervals, in {worst} {r.longest_s:.4g} s after row {r.longest_row}; "
               f"the longest of the others is {r.others_s:.3g} s. Split the session {where}: a row is predicted from "
               "the one before.")  # fmt: skip


def _of_repeats(found: Sequence[Repeat]) -> Iterator[str]:
    duplicates = [f"{r.second} (same as {r.first})" for r in found if r.rows == r.of]
    if duplicates:
        yield (f"Duplicate sessions: {_named(duplicates)}. Remove one of each: held-out sessions must not be among the "
               "fitted ones.")  # fmt: skip
    overlaps = [f"{r.first} and {r.second} ({r.rows:,} rows)" for r in found if r.rows < r.of]
    if overlaps:
        yield (f"Overlapping sessions: {_named(overlaps)}. Cut them so that no row occurs twice.")


def _of_columns(schema: Schema, columns: Mapping[str, survey.Column]) -> Iterator[str]:
    state = {f.name for f in schema.state}
    for name, c in columns.items():
        if c.low == c.high == 0 and name not in state:
            continue  # reported by `_of_commands`
        if c.low == c.high:
            yield f"{name} is always {c.low:.4g}. Effects that depend on it cannot be found."
        elif name in state and c.still:
            yield (f"{name} never changes in {_named(c.still)}, but does in other sessions. Check whether the sensor "
                   "was off; if so, leave these sessions out.")  # fmt: skip
        elif name in state and c.repeated > 0.5:
            yield (f"{name} repeats its last value in {c.repeated:.0%} of the rows. Its sensor may be slower than the "
                   "recorder: lower the rate.")  # fmt: skip
        if c.jumps:
            where = ", ".join(f"{session} row {row}" for session, row in c.jumps[:NAMED])
            yield (f"{name} jumps {len(c.jumps)} times ({where}). Check for outliers, resets, or an angle that does "
                   "not wrap at pi.")  # fmt: skip


def _of_velocities(found: Survey) -> Iterator[str]:
    turned: set[str] = set()
    for f in found.frames:
        if f.turned < TURNED or TURNED_BETTER * (1 - f.turned) > 1 - f.as_is:
            continue
        turned.update(f.velocities)
        there, should = ("the body's", "the world's") if f.world else ("the world's", "the body's")
        remedy = (
            "give `frame: body` for them in the mapping (`simgap import`), or rotate them" if f.world else "rotate them"
        )
        yield (f"{', '.join(f.velocities)} do not match the change of {', '.join(f.positions)} (agreement "
               f"{f.as_is:.2f}); they do if rotated by {f.yaw} ({f.turned:.2f}). They are along {there} axes and "
               f"must be along {should}. To fix it, {remedy}.")  # fmt: skip
    for name, k in found.kinematics.items():
        if name in turned:
            continue
        if abs(k.correlation) < 0.5:
            yield (f"{name} does not match the change of {k.position} (correlation {k.correlation:.2f}). Check "
                   "frames (world or body), topic and clocks.")  # fmt: skip
        elif not 0.8 < k.slope < 1.25:
            caveat = " A simulator that has a parameter for that factor may still be right." if k.in_other_units else ""
            yield survey.sentence(name, k) + caveat
    yield from (sentence(d) for d in found.derived)


def _of_commands(found: Survey) -> Iterator[str]:
    for name, f in found.following.items():
        if abs(f.correlation) < FOLLOWS or 1 / UNUSUAL < f.slope < UNUSUAL:
            continue
        if f.slope < 0:
            yield (f"{f.measured} moves opposite to {name} (correlation {f.correlation:.2f}). Check signs and axes: "
                   "give `sign: -1` in the mapping (`simgap import`).")  # fmt: skip
            continue
        factor = max(f.slope, 1 / f.slope)
        like = next(
            (f", as between {units}" for units, u in UNITS.items() if 1 / UNIT_GAIN < factor / u < UNIT_GAIN), ""
        )
        large, small = (name, f.measured) if f.slope < 1 else (f.measured, name)
        yield (f"{large} is {factor:.3g} times {small} (correlation {f.correlation:.2f}){like}. Check the units of "
               "both: give `unit` in the mapping (`simgap import`).")  # fmt: skip
    for name, e in found.excitation.items():
        constant = found.columns[name].low == found.columns[name].high
        if e.moving == 0:
            yield f"The command {name} is never used, so its effect cannot be determined. Record sessions that use it."
        elif e.moving < 0.05 and not constant:
            yield f"The command {name} moves in only {e.moving:.1%} of the rows. Record more of it."
        if abs(e.correlation) > 0.95 and name < e.like:
            yield (f"The commands {name} and {e.like} move together (correlation {e.correlation:.2f}), so their "
                   "effects cannot be separated. Record them independently.")  # fmt: skip
