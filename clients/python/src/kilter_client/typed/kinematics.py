"""What the server answers about kinematics, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records
from kilter_client.typed.robots import Pose


class Flanges(Record):
    """Poses of the flange, without the robot's own tool, in the frame of its root, without its base."""

    flanges: Records[Pose]
    """The flange in the frame of the robot's root, row by row."""


class Posture(Record):
    """Joints that bring the flange to a pose, and which of the arm's branches they are."""

    elbow_up: bool
    """Whether the elbow, with the wrist in front, is above the line to it."""
    front: bool
    """Whether the wrist is on the side of the root's x axis, with joint 1 at zero."""
    joints_deg: tuple[float, ...]
    """Joints, degrees, each within 180 degrees of zero; limits are not looked at."""
    named: bool
    """Whether `front`, `elbow_up` and `wrist` tell the branches; those of an arm without a closed form have no names, and the three are false."""
    singular: bool
    """Whether two axes are in line, so that their joints cannot be told apart."""
    wrist: bool
    """Which of the two bends of joint 5 it is."""


class Postures(Record):
    """All joints of each pose."""

    certain: tuple[bool, ...]
    """Whether these are surely all, row by row. They are in closed form; else near a singularity they may not be."""
    postures: tuple[Records[Posture], ...]
    """Postures of each row; none: it cannot be reached."""
