"""What the server answers about effect curves, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records


class CurveDistance(Record):
    """How far the curves of both directions are apart, on average, in `unit`."""

    high: float
    """Upper end of the 95 % interval."""
    low: float
    """Lower end of the 95 % interval."""
    value: float
    """The one of direction 1 less the one of -1."""


class CurveSide(Record):
    """A curve over the quantity that an effect follows."""

    direction: float | None
    """Direction of the last motion, 1 or -1; None: it does not count."""
    high: tuple[float, ...]
    """Upper end of the 95 % band; None: it has none."""
    low: tuple[float, ...]
    """Lower end of the 95 % band; None: it has none."""
    x: tuple[float, ...]
    """Values of the quantity, in `x_unit`."""
    y: tuple[float, ...]
    """What the joint rotates or moves by, in `unit`."""


class CurveRival(Record):
    """The refused effect that comes nearest to the visits, with a zero of its own."""

    id: str
    """Id of the effect."""
    joints: tuple[int, ...]
    """Joints it acts at, from 1; None: it does not act at joints."""
    sides: Records[CurveSide]
    """Its curve, or one for each direction."""
    times: float
    """Squares that it leaves at the visits, as a multiple of those that the curve leaves."""


class CurveVisits(Record):
    """What each visit says that an effect does: the curve and what is left, as motion of the joint."""

    curve: tuple[float, ...]
    """What the curve says there, in `unit`."""
    direction: tuple[float, ...]
    """Direction of the last motion; None: it does not count."""
    faint: int
    """Visits that say too little of this joint to be drawn: the tool is near its axis."""
    half: tuple[float, ...]
    """Half of its 95 % interval, in `unit`."""
    of: int
    """Visits that the search used."""
    x: tuple[float, ...]
    """Values of the quantity, in `x_unit`."""
    y: tuple[float, ...]
    """What the visit says, in `unit`."""


class EffectCurve(Record):
    """What a named effect does to one of its joints, over the quantity that it follows; no lever arm is in it."""

    distance: CurveDistance | None
    """How far both directions are apart; None: there is one."""
    follows: str
    """The quantity: `q` (of the joint), `axial` (load about or along it), `t` (from the first visit on) or `temperature_c`."""
    id: str
    """Id of the effect."""
    joint: int
    """The joint, from 1."""
    joints: tuple[int, ...]
    """Joints it acts at, from 1; None: it does not act at joints."""
    rival: CurveRival | None
    """What was refused; None: nothing that follows the same quantity."""
    sides: Records[CurveSide]
    """The curve, or one for each direction of the last motion."""
    unit: str
    """Unit of what the joint rotates or moves by."""
    visits: CurveVisits
    """What the visits say, at most 400 of them."""
    x_unit: str
    """Unit of the quantity."""
