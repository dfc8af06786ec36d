"""The catalogue as a page: `python -m simgap.effects.table` prints docs/reference/effects.md."""

from itertools import groupby

from simgap.effects import CATALOGUE
from simgap.effects.behind_joints import BEHIND_JOINTS
from simgap.effects.effect import Effect

_PLACES = {
    "command": "On the command, before the step",
    "filter": "On the command, with a memory",
    "before": "On the motion, before the step",
    "push": "Push a body",
    "friction": "Push a body against its motion, at most to rest",
    "hysteresis": "Push a body, with a memory",
    "after": "On the motion, after the step",
    "sensing": "On what is measured of the state",
}
_HEAD = """# Effects: the vocabulary of the diagnosis

Printed from `simgap.effects.CATALOGUE` by `python -m simgap.effects.table`. Not in it are [effects on the
noise](../explanation/method.md#effects-on-the-noise). `{u}` is the unit of the command, or of the axis, that an effect
acts on, `{x}` that of the position there. A name in braces stands for the constant of that name.
"""

_BEHIND = """## Hidden between motor and link

Rivals of what is found at a joint of a MuJoCo model, with the encoder at the link or at the motor. `{u}` is the unit of
the joint's position, `{force}` that of its effort.

| effect | constants | in words |
| --- | --- | --- |"""


def page() -> str:
    """The page, in Markdown."""
    lines = [_HEAD]
    for place, effects in groupby(sorted(CATALOGUE, key=lambda e: list(_PLACES).index(e.place)), lambda e: e.place):
        lines += [f"## {_PLACES[place]}\n", "| effect | constants | in words | what may share constants |",
                  "| --- | --- | --- | --- |", *map(_row, effects), ""]  # fmt: skip
    lines += [_BEHIND, *(f"| `{id}` | {c.constant} [{c.unit}] | {c.says} |" for id, c in BEHIND_JOINTS.items()), ""]
    return "\n".join(lines)


def _row(effect: Effect) -> str:
    constants = ", ".join(f"{c.name} [{c.unit}]" for c in effect.constants)
    tie = {"never": "-", "same_unit": "sites of one unit", "any": "all sites"}[effect.tie]
    says = effect.says + " (during a stretch)" * effect.event
    return f"| `{effect.key}` | {constants} | {says} | {tie} |"


if __name__ == "__main__":
    print(page(), end="")
