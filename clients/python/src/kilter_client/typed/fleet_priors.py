"""What the server answers about fleet priors, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records


class FleetVersion(Record):
    """A version of another robot of the type."""

    reason: str | None
    """Why a prior does without it; None: it is part of it."""
    robot: str
    """Name of the robot."""
    version: str
    """Id of its version."""


class LeftOneOut(Record):
    """A robot as the others of its type predict it."""

    chi_square: float | None
    """Chi-square of its parameters against the others' prior."""
    compared: int | None
    """Parameters that were compared."""
    p_value: float | None
    """Chance of as large a chi-square for a robot of the type."""
    robot: str
    """Name of the robot."""


class PriorUsed(Record):
    """What other robots of the type said beforehand, and how far this arm was believed to be as they are."""

    chi_square: float | None
    """Chi-square of the arm against its type."""
    compared: int | None
    """Directions that were compared."""
    left_one_out: Records[LeftOneOut]
    """how well the robots predict each other."""
    left_out: Records[FleetVersion]
    """Versions of another gauge, which it does without."""
    limited_by: float | None
    """Part of that factor, so that the type may move the tool by 0.26 of the error that is expected without it, and no more; 1: none. Null: stored without."""
    odd: tuple[str, ...]
    """Parameters in which the arm is not as its type: the rows alone say."""
    p_value: float | None
    """Chance of as large a chi-square for a robot of the type."""
    parameters: tuple[str, ...]
    """Parameters that rest on the prior and not on the rows."""
    sentence: str | None
    """All of that in words."""
    source: str | None
    """`fleet`: versions of other robots of the type."""
    state: str | None
    """`used` as it is; `widened`, since this arm is odder than most, `odd` in some parameters, or moved by the type farther than its rows allow; `dropped`, since it is not as its type."""
    versions: Records[FleetVersion]
    """The versions it rests on."""
    widened_by: float | None
    """Factor of its standard deviations; None: dropped."""
