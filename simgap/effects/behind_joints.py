"""Effects with a hidden state between the motor and the link of a joint, which engines may have as rivals.

They are no laws of the catalogue: an engine that has one has it as its last term, and two more states (see
`engines.split_of`).
"""

from typing import NamedTuple


class BehindJoint(NamedTuple):
    """Name and unit of the constant (`{u}`: unit of the position, `{force}`: of the effort), and a sentence."""

    constant: str
    unit: str
    says: str


BEHIND_JOINTS = {
    "link_backlash": BehindJoint(
        "gap", "{u}", "play: after a reversal the motor turns through a gap of {gap} before it drags the link"
    ),
    "elastic_joint": BehindJoint(
        "stiffness", "{force}/{u}", "an elastic joint: a spring of {stiffness} between motor and link"
    ),
}
"""By id."""
