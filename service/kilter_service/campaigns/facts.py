"""The facts of a campaign, read from its rows; kept where somebody looked lately: a million rows take seconds to look at."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import CoreError
from kilter_core.observations import Observations as Seen
from kilter_core.observations import identical_repeats, with_directions
from kilter_files.ground.later import pc
from kilter_service.campaigns import looking
from kilter_service.campaigns.belonging import Judged, judged_whole
from kilter_service.campaigns.looking import MAD, Repeats, Rows, repeats
from kilter_service.contract.campaigns import Campaign
from kilter_service.ground.core import core_identify, core_model, transforms
from kilter_service.ground.db import Database
from kilter_service.ground.limits import Recent
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.wire import to_deg, to_mm

if TYPE_CHECKING:
    from kilter_core.arm import Joint, Robot
    from kilter_core.observations import Observations
    from kilter_core.types import Floats
    from kilter_service.ground.tables.columns import Column


MOST_FACTS = 24
_facts = Recent["Facts"](MOST_FACTS)


def campaign_cache_key(campaign: Campaign) -> tuple[str, ...]:
    """Return what tells the rows of a campaign from all others, and from its own with other files."""
    return campaign.id, str(campaign.conditions), *(upload.sha256 for upload in campaign.uploads)


def cached_campaign_facts(
    database: Database, campaign: Campaign, reading: Callable[[Rows], None] | None = None
) -> Facts:
    """Return the facts of a campaign; ``reading`` gets its rows where they had to be read.

    Raises:
        ObservationError: nothing was uploaded yet. ServiceError: no such campaign, or parts of it are missing.

    """

    def read() -> Facts:
        rows = looking.load_campaign_rows(database, campaign.id)
        found = facts(rows)
        if reading is not None:
            reading(rows)
        return found

    return _facts.get(campaign_cache_key(campaign), read)


MOST = 200  # rows that are named
MOVED = 1e-4  # rad or m: a joint has moved
BEYOND = 5e-3  # rad or m outside the limits: more than their rounding
FAR = 8.0  # robust standard deviations from where the arm would be
LEAST_M = 1e-3
MOST_PLACED = 50_000  # rows whose places are compared with the arm's
ROUNDS = 12
FEWEST_SUSPECT_ROWS = 12


@dataclass(frozen=True)
class Doubt:
    """A row, from 1, what looks wrong with it, and how far off it is: in mm, and in robust standard deviations."""

    row: int
    why: str
    mm: float | None = None
    sigma: float | None = None


@dataclass(frozen=True)
class Doubtful:
    """The first rows that look wrong, and how many there are."""

    rows: tuple[Doubt, ...]
    count: int


def doubtful(robot: Robot, seen: Observations, points: Floats | None, repeats: Repeats) -> Doubtful:
    """Name rows outside the limits, apart from their repeats, stuck at a reading, or far from where the arm would be."""
    found: dict[int, list[Doubt]] = {}

    def add_doubt(row: int, why: str, away: float | None = None, sigma: float | None = None) -> None:
        mm = None if away is None else float(to_mm(away))
        found.setdefault(row + 1, []).append(Doubt(row + 1, why, mm, sigma))

    _beyond(robot, seen, add_doubt)
    for row, distance, sigma in zip(repeats.far, repeats.distance, repeats.sigmas, strict=True):
        why = f"{to_mm(float(distance)):.3g} mm from the other rows of its pose"
        add_doubt(int(row), why, float(distance), float(sigma) if np.isfinite(sigma) else None)
    if points is not None:
        for row in _stuck(seen.q, points):
            add_doubt(int(row), "the same position as the row before to the last digit, though joints moved")
        for row, distance, sigma in _find_misplaced_rows(robot, seen, points):
            why = f"{to_mm(distance):.3g} mm from where the nominal arm would be, far more than other rows"
            add_doubt(row, why, distance, sigma)
    for row, distance in _of_other_pictures(robot, seen):
        why = "its picture shows the board far from where its joints would have it"
        add_doubt(row, why, distance if np.isfinite(distance) else None)
    named = sorted(found.items())[:MOST]
    return Doubtful(tuple(_together(doubts) for _, doubts in named), len(found))


def _together(doubts: Sequence[Doubt]) -> Doubt:
    """All that is said of a row; of the sizes those that stand out most."""
    lead = max(doubts, key=lambda one: (one.sigma or 0.0, one.mm or 0.0))
    return Doubt(lead.row, "; ".join(one.why for one in doubts), lead.mm, lead.sigma)


def _beyond(robot: Robot, seen: Observations, take: object) -> None:
    assert callable(take)
    for k, joint in enumerate(robot.joints):
        out = np.maximum(joint.lower - seen.q[:, k], seen.q[:, k] - joint.upper)
        for row in np.flatnonzero(out > BEYOND)[:MOST]:
            size = to_mm(out[row]) if joint.kind == "prismatic" else to_deg(out[row])
            unit = "mm" if joint.kind == "prismatic" else "deg"
            take(int(row), f"joint {joint.name} is {float(size):.3g} {unit} outside its limits")


def _stuck(q: Floats, points: Floats) -> NDArray[np.int64]:
    same = (np.diff(points, axis=0) == 0).all(axis=1)
    moved = np.abs(np.diff(q, axis=0)).max(axis=1) > MOVED
    return np.flatnonzero(same & moved).astype(np.int64) + 1


def _find_misplaced_rows(robot: Robot, seen: Observations, points: Floats) -> list[tuple[int, float, float]]:
    """Rows far from the nominal arm, base and tool point fitted to the others: m, and robust standard deviations."""
    there = np.flatnonzero(~np.isnan(points).any(axis=1))
    there = there[:: max(1, len(there) // MOST_PLACED)]
    if len(there) < FEWEST_SUSPECT_ROWS or (seen.session is not None and len(np.unique(seen.session)) > 1):
        return []
    left = _distances_from_nominal(robot, seen.q[there], points[there])
    middle = float(np.median(left))
    usual = max(MAD * float(np.median(np.abs(left - middle))), LEAST_M / FAR)
    far = np.flatnonzero(left - middle > FAR * usual)
    return [(int(there[row]), float(left[row]), float((left[row] - middle) / usual)) for row in far[:MOST]]


def _of_other_pictures(robot: Robot, seen: Observations) -> list[tuple[int, float]]:
    """Rows whose joints are not those of their picture, and how far off the board is there, m."""
    if seen.pixels is None:
        return []
    try:
        return core_identify.far_views(core_model.Calibration.nominal(robot), seen)[:MOST]
    except CoreError:
        return []  # what is wrong with all of them a job says


def _distances_from_nominal(robot: Robot, q: Floats, points: Floats) -> Floats:
    """How far (m) each point is from the nominal arm; base and tool point are fitted to the nearer half in turn."""
    model = core_model.Calibration.nominal(robot).model
    pose = model.in_frames(np.eye(4), np.eye(4)).predict(Seen(q), model.values0())
    f, F = pose.position, pose.rotation
    tool, kept = model.T_tool[:3, 3], np.ones(len(q), dtype=bool)
    left = np.zeros(len(q))
    for _ in range(ROUNDS):
        body = f + F @ tool
        a, b = body[kept].mean(axis=0), points[kept].mean(axis=0)
        R = transforms.nearest_rotation((body[kept] - a).T @ (points[kept] - b))
        local = (points - b) @ R.T + a
        tool = np.median(np.einsum("nji,nj->ni", F, local - f)[kept], axis=0)
        left = np.linalg.norm(f + F @ tool - local, axis=1)
        kept = left <= np.quantile(left, 0.75)
    return np.asarray(left)


BINS = 24  # of the histogram of a joint's readings
MOST_LOADS = 12
MOST_PLACES = 500  # that are drawn


@dataclass(frozen=True)
class ColumnFacts:
    """A column in the unit that people read: from where to where, and how many cells are empty."""

    name: str
    what: str
    unit: str
    low: float | None
    high: float | None
    empty: int


@dataclass(frozen=True)
class JointFacts:
    """Readings of a joint in deg or mm against its limits (None: open), and how many there are in each part of them.

    ``share`` is how much of the room between the limits the readings span; ``bins`` go from ``bin_low`` to ``bin_high``.
    """

    name: str
    unit: str
    low: float
    high: float
    limits: tuple[float | None, float | None]
    share: float | None
    bin_low: float
    bin_high: float
    bins: tuple[int, ...]


@dataclass(frozen=True)
class Approach:
    """How many rows reached a joint's place from below, from above, or from where is not known."""

    joint: str
    up: int
    down: int
    unknown: int


@dataclass(frozen=True)
class Facts:
    """All of it. ``stated`` says whether directions are a column of the file; else they follow from the order of rows.

    ``places`` are some rows (from 1) and where the tool was seen, mm: those that look wrong are among them. ``mixed_up``
    says why no job takes the rows, and ``odd`` what may be right.
    """

    rows: int
    columns: tuple[ColumnFacts, ...]
    joints: tuple[JointFacts, ...]
    repeats: Repeats
    by_number: bool
    approaches: tuple[Approach, ...]
    stated: bool
    loads: tuple[tuple[str, int], ...]
    temperature: tuple[float, float] | None
    sessions: int
    doubtful: Doubtful
    places: tuple[tuple[int, tuple[float, float, float]], ...]
    mixed_up: str = ""
    odd: tuple[str, ...] = ()


def facts(rows: Rows, known: Judged | None = None) -> Facts:
    """Look at rows; some seconds for a million of them. ``known``: what is known already of mix-ups in them."""
    belong = known or judged_whole(rows.table, rows.columns, rows.robot, rows.conditions)
    seen = observations(rows.table, rows.columns, rows.conditions)
    points = _points(seen)
    # Copies of a row repeat its pose without a reading: their noise would be nothing.
    read = None if points is None else np.where(identical_repeats(seen)[:, None], np.nan, points)
    found = repeats(seen.pose_groups(), seen.conditions(), seen.visits(), read)
    odd = doubtful(rows.robot, seen, points, found)
    return Facts(
        rows=len(seen),
        columns=tuple(_column(column, rows.table) for column in rows.columns),
        joints=tuple(_joint(joint, seen.q[:, k]) for k, joint in enumerate(rows.robot.joints)),
        repeats=found,
        by_number=seen.pose_id is not None,
        approaches=tuple(_approaches(rows.robot.joints, seen)),
        stated=seen.stated_direction is not None,
        loads=_loads(seen),
        temperature=_span(seen.temperature_c),
        sessions=1 if seen.session is None else len(np.unique(seen.session)),
        doubtful=odd,
        places=() if points is None else _places(points, odd),
        mixed_up="" if belong.refusal is None else belong.refusal.message,
        odd=tuple(str(one["message"]) for one in belong.warnings),
    )


def _places(points: Floats, odd: Doubtful) -> tuple[tuple[int, tuple[float, float, float]], ...]:
    """Rows to draw: evenly chosen, the outermost, and those that look wrong."""
    there = np.flatnonzero(~np.isnan(points).any(axis=1))
    if not len(there):
        return ()
    ends = {int(there[pick(points[there, k])]) for k in range(3) for pick in (np.argmin, np.argmax)}
    marked = {one.row - 1 for one in odd.rows} & set(there.tolist())
    chosen = sorted({*there[:: max(1, -(-len(there) // MOST_PLACES))].tolist(), *ends, *marked})
    shown = to_mm(points[chosen])
    return tuple((row + 1, (float(x), float(y), float(z))) for row, (x, y, z) in zip(chosen, shown, strict=True))


def _points(seen: Observations) -> Floats | None:
    """What was seen of the tool, m: its point, else the first marker."""
    if seen.position is not None:
        return seen.position
    return None if seen.markers is None else seen.markers[:, 0]


UNITS: Mapping[str, tuple[str, float]] = {"rad": ("deg", float(to_deg(1.0))), "m": ("mm", to_mm(1.0))}


def display_unit_and_factor(column: Column) -> tuple[str, float]:
    """Return the unit in which people read a column, and the factor to it."""
    stem = f"{column.quantity}{'' if column.number is None else column.number + 1}"
    stated = column.name.rpartition("_")[2] if "_" in column.name else ""
    if column.is_integer or column.quantity in ("qw", "qx", "qy", "qz") or stated == stem:
        return "", 1.0
    for end, (_, factor) in UNITS.items():
        for rate in ("_s2", "_s", ""):
            if column.name.endswith(f"_{end}{rate}"):
                return f"{UNITS[end][0]}{rate.replace('_', '/')}", factor
            shown = UNITS[end][0]
            if column.name.endswith(f"_{shown}{rate}"):
                return f"{shown}{rate.replace('_', '/')}", 1.0
    return {"c": "°C", "n": "N", "nm": "N m"}.get(stated, stated), 1.0


def _column(column: Column, table: Any) -> ColumnFacts:
    cells = table.column(column.name)
    unit, factor = display_unit_and_factor(column)
    ends = pc.min_max(cells).as_py()
    low, high = ends["min"], ends["max"]
    return ColumnFacts(
        column.name,
        meaning(column),
        unit,
        None if low is None else low * factor,
        None if high is None else high * factor,
        cells.null_count,
    )


MEANINGS: Mapping[str, str] = {
    "q": "reading of joint {0}",
    "link": "link-side encoder of joint {0}",
    "cmd": "command of joint {0}",
    "qd": "speed of joint {0}",
    "qdd": "acceleration of joint {0}",
    "tau": "torque of joint {0}",
    "dir": "direction joint {0} came from",
    "x": "position along x",
    "y": "position along y",
    "z": "position along z",
    "t": "time",
    "payload": "load at the tool",
    "temperature": "temperature of the arm",
    "session": "set-up of the instrument",
    "base_tilt_x": "tilt of the base about x, as an input",
    "base_tilt_y": "tilt of the base about y, as an input",
    "camera": "which camera",
    "board": "which board",
    "pixel_u": "corner {0} of the board, to the right",
    "pixel_v": "corner {0} of the board, down",
    "pixel_su": "deviation of corner {0}, to the right",
    "pixel_sv": "deviation of corner {0}, down",
    "pose_id": "number of the pose",
    "row": "number of the row as measured",
    "bar": "length of the ball bar",
    "bar_id": "which ball bar",
    "socket_id": "which socket",
    "plane_id": "which plane",
    "qw": "orientation (quaternion)",
    "qx": "orientation (quaternion)",
    "qy": "orientation (quaternion)",
    "qz": "orientation (quaternion)",
    "phi": "orientation (ZXZ, first)",
    "theta": "orientation (ZXZ, second)",
    "psi": "orientation (ZXZ, third)",
}


def _load(part: str, number: str) -> str:
    """Say in words what a load on a link is."""
    if part == "kg":
        return f"mass on link {number} beyond its own"
    what = {"f": "force along", "m": "moment about"}.get(part[0], "place of the mass along") if len(part) > 1 else ""
    return f"{what or 'place of the mass along'} {part[-1]}, on link {number}"


def meaning(column: Column) -> str:
    """Say in words what a column is."""
    number = "" if column.number is None else str(column.number + 1)
    if column.quantity in MEANINGS:
        return MEANINGS[column.quantity].format(number)
    if column.quantity.startswith("marker_"):
        return f"marker {number} along {column.quantity[-1]}"
    if column.quantity.startswith("tilt_"):
        return f"inclination of {'the base' if number == '0' else f'link {number}'} about {column.quantity[-1]}"
    if column.quantity.startswith("load_"):
        return _load(column.quantity.removeprefix("load_"), number)
    kinds = {
        "s": "deviation of the position along",
        "f": "force along",
        "m": "moment about",
        "tip": "digitised tip along",
    }
    stem, axis = column.quantity[:-1], column.quantity[-1]
    if stem in kinds:
        return f"{kinds[stem]} {axis}"
    return f"centre of the load along {axis}" if stem == "payload_com_" else column.quantity


def _joint(joint: Joint, readings: Floats) -> JointFacts:
    slides = joint.kind == "prismatic"
    scale = to_mm(1.0) if slides else float(to_deg(1.0))
    shown = readings * scale
    limits = [float(end) * scale if np.isfinite(end) else None for end in (joint.lower, joint.upper)]
    low, high = float(shown.min()), float(shown.max())
    bin_low, bin_high = (low if limits[0] is None else limits[0], high if limits[1] is None else limits[1])
    bin_low, bin_high = min(bin_low, low), max(bin_high, high)
    if bin_high <= bin_low:
        bin_low, bin_high = bin_low - 0.5, bin_high + 0.5
    counts = np.histogram(shown, bins=BINS, range=(bin_low, bin_high))[0]
    share = None
    if limits[0] is not None and limits[1] is not None and limits[1] > limits[0]:
        share = (high - low) / (limits[1] - limits[0])
    return JointFacts(
        joint.name,
        "mm" if slides else "deg",
        low,
        high,
        (limits[0], limits[1]),
        share,
        bin_low,
        bin_high,
        tuple(int(count) for count in counts),
    )


def _approaches(joints: tuple[Joint, ...], seen: Observations) -> Iterator[Approach]:
    found = with_directions(seen).direction
    signs = np.zeros_like(seen.q) if found is None else found
    for k, joint in enumerate(joints):
        up, down = int((signs[:, k] > 0).sum()), int((signs[:, k] < 0).sum())
        yield Approach(joint.name, up, down, len(seen) - up - down)


def _loads(seen: Observations) -> tuple[tuple[str, int], ...]:
    if seen.payload_kg is None:
        return ()
    values, counts = np.unique(np.round(seen.payload_kg, 4), return_counts=True)
    if len(values) > MOST_LOADS:
        return ((f"{values[0]:g} to {values[-1]:g} kg, {len(values)} different ones", len(seen)),)
    return tuple((f"{value:g} kg", int(count)) for value, count in zip(values, counts, strict=True))


def _span(values: Floats | None) -> tuple[float, float] | None:
    return None if values is None or not len(values) else (float(np.nanmin(values)), float(np.nanmax(values)))
