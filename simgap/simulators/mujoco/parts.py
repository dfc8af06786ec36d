"""Parts of a model that a diagnosis knows: joints, actuators, joints that follow others, and a deflection."""

from dataclasses import dataclass

from simgap.types import Axis, Kind


@dataclass(frozen=True)
class Joint:
    """A joint with one degree of freedom, whose position is recorded. qpos, dof: its indices in MuJoCo's vectors.

    floating: whether it is one of the six in place of a free joint.
    """

    name: str
    index: int
    qpos: int
    dof: int
    hinge: bool
    speed_recorded: bool
    floating: bool = False

    @property
    def kind(self) -> Kind:
        """Kind of its position: an angle of a body that floats is recorded up to whole turns."""
        return "angle" if self.floating and self.hinge else "position"

    @property
    def effort(self) -> str:
        """Unit of the force along it."""
        return "N m" if self.hinge else "N"

    @property
    def unit(self) -> str:
        """Unit of its position."""
        return "rad" if self.hinge else "m"

    @property
    def axis(self) -> Axis:
        """Its axis in the schema."""
        return "yaw" if self.hinge else "x"


@dataclass(frozen=True)
class Actuator:
    """An actuator whose command is recorded. joint: the one it acts on, if any. control, act: indices in MuJoCo's
    vectors of its control and of its own state, if it has one."""

    name: str
    index: int
    control: int
    act: int | None
    kind: Kind
    joint: Joint | None


@dataclass(frozen=True)
class Follower:
    """A joint that an equality constraint ties to another, its leader: its offset is a polynomial of the leader's."""

    qpos: int
    dof: int
    leader: int
    polynomial: tuple[float, ...]


@dataclass(frozen=True)
class Deflection:
    """A second hinge or slide behind a joint, along the same axis: the link moves against the motor.

    joint: index of the joint, which is the motor's side, in `Machine.joints`. index, qpos, dof: those of the
    deflection. at_link: the recorded position is that of the link, motor plus deflection; otherwise it is the motor's.
    """

    joint: int
    index: int
    qpos: int
    dof: int
    at_link: bool
