"""What a row of observations must be, checked on one piece of an upload after the other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import FindingDocument, ObservationError
from kilter_core.types import Floats
from kilter_service.campaigns.belonging import Belonging
from kilter_service.campaigns.view_rules import ViewRules
from kilter_service.contract.columns import BASE, CONTACTS, NAMED, PLACE, TILTS
from kilter_service.ground.core import core_identify
from kilter_service.ground.tables.columns import Column
from kilter_service.robots.check import heaviest_likely_payload, longest_reach

if TYPE_CHECKING:
    import pyarrow as pa

    from kilter_core.arm import Joint, Robot


QUATERNION_TOLERANCE = 1e-3
ABSOLUTE_ZERO_C = -273.15
UPRIGHT = 0.95  # cosine to the vertical from which an inclinometer does not see rotations about an axis (18 degrees)
# Two points of a workspace are at most twice the reach apart; three leaves room for a long tool.
IMPOSSIBLE_REACHES = 3.0
SMALL, LARGE = 0.2, 1.5  # of the reach: positions that spread less or more are compared with what the joints command
SAMPLE_ROWS = 500
UNITS_MM = {1e3: "m", 100.0: "dm", 25.4: "inch", 10.0: "cm", 1.0: "mm", 1e-3: "um"}

# Many URDFs round limits to two decimals of a radian (2.09 for 120 deg), and to a mm for a prismatic joint.
TOLERANCE = {"deg": math.radians(0.3), "mm": 0.5e-3}
# Arms move some degrees beyond what their drawing states; a wrong unit, sign or joint goes further in some row.
DOUBTFUL = {"deg": math.radians(10.0), "mm": 20e-3}
MOST_ROWS = 1000  # that are named one by one in the error's context
SHOWN = 8
BEYOND_LIMITS = "beyond_limits"

UNLIKELY = "payload_unlikely"


class RowRules:
    """The rules for one upload to one robot; `check` every piece in order, then `finish`."""

    def __init__(
        self,
        columns: Sequence[Column],
        robot: Robot,
        views: ViewRules | None = None,
        conditions: dict[str, Any] | None = None,
    ) -> None:
        self.columns = columns
        self._views = views
        self.robot = robot
        self.rows = 0
        self._beside = _optional_quantities(columns)
        self._limits = JointLimits()
        self._payload = PayloadSize(robot)
        self._belonging = Belonging(columns, robot, conditions)
        self._unchecked = bool((conditions or {}).get("unchecked"))
        self._low: dict[str, float] = {}
        self._high: dict[str, float] = {}
        self._sample: list[tuple[Floats, Floats]] = []
        _refuse_upright(columns, robot)

    def check(self, table: pa.Table) -> None:
        """Check the next rows.

        Raises:
            ObservationError: an invalid cell; row and column are named.

        """
        cells = {c.name: table.column(c.name).to_numpy(zero_copy_only=False) for c in self.columns}
        for column in self.columns:
            self._check_column(column, cells[column.name])
        self._check_markers(cells)
        self._check_tips(cells)
        self._check_place(cells)
        self._check_nothing(cells)
        self._check_contacts(cells)
        self._check_quaternions(cells)
        if self._views is not None:
            self._views.check(cells, self.rows)
        self._remember(cells)
        self._belonging.add_rows(table)
        self.rows += table.num_rows

    def finish(self) -> tuple[FindingDocument, ...]:
        """Check what only the whole upload shows: whether the rows belong to the robot, readings outside the limits, and
        whether the arm could reach that far; return warnings about what only looks odd.

        Raises:
            ObservationError: ``foreign_observations``, readings outside the limits, or positions that cannot be in their
                unit.

        """
        found = self._belonging.check_collected_rows()
        if not self._unchecked:
            self._check_units(next((one for one in found.warnings if one["code"] == "rows_astray"), None))
        # Another unit, sign or zero explains limits better than wrong rows.
        beyond = () if found.explains_limits else self._limits.finish()
        if found.refusal is not None:
            raise found.refusal
        return (*found.warnings, *beyond, *self._payload.warnings())

    def _check_units(self, astray: Mapping[str, Any] | None) -> None:
        reach = longest_reach(self.robot)
        spreads = {c: self._high.get(c.name, 0.0) - self._low.get(c.name, 0.0) for c in self._lengths()}
        if not spreads or not reach > 0 or not self._sample:
            return
        column = max(spreads, key=lambda c: spreads[c])
        if not SMALL * reach < spreads[column] < LARGE * reach:
            self._check_unit(next(iter(spreads)))
        if spreads[column] > IMPOSSIBLE_REACHES * reach:
            why = f"the values are not in {column.name.rpartition('_')[2]}, or not of this robot."
            raise ObservationError(
                f"Column {column.name!r} spreads over {spreads[column]:.3g} m, but the arm reaches {reach:.3g} m: "
                f"{astray['message'] if astray else why} {core_identify.WAY_OUT}",
                column=column.name,
                spread_m=spreads[column],
                **({"rows": astray["rows"]} if astray else {}),
            )

    def _check_column(self, column: Column, cells: Floats) -> None:
        if not column.may_be_empty and column.quantity not in self._beside:
            self._refuse(np.isnan(cells), column.name, "is empty: only markers, corners, tips and tilts may be missing")
        if column.is_integer:
            self._refuse(cells != np.round(cells), column.name, "is not a whole number", cells)
        if column.quantity == "dir":
            self._refuse(np.abs(cells) > 1, column.name, "is not -1, 0 or 1", cells)
        if column.quantity in ("payload", "load_kg"):
            self._refuse(cells < 0, column.name, "is negative", cells)
        if column.quantity == "payload":
            self._payload.add_payloads(column, cells)
        if column.quantity in ("sx", "sy", "sz"):
            self._check_position(column)
            self._refuse(cells <= 0, column.name, "is not a standard deviation: it must be above 0", cells)
        if column.quantity == "temperature":
            self._refuse(cells < ABSOLUTE_ZERO_C, column.name, "is below absolute zero", cells)
        if column.quantity == "q" and column.number is not None:
            self._limits.check(column, self.robot.joints[column.number], cells, self.rows + 1)

    def _check_position(self, column: Column) -> None:
        """Refuse the deviation of a position that no column measures: it would count for nothing, and nobody would see it."""
        if not any(c.quantity in ("x", "marker_x") for c in self.columns):
            raise ObservationError(
                f"Column {column.name!r} states the deviation of a measured position, and these rows have none: leave sx_mm, "
                "sy_mm and sz_mm out. The noise of contacts, link encoders and inclinometers comes from repeats of poses, "
                "else from what the fit leaves; --noise-mm states that of contacts.",
                column=column.name,
            )

    def _check_markers(self, cells: dict[str, Floats]) -> None:
        for x in (c for c in self.columns if c.quantity == "marker_x"):
            group = sorted(c.name for c in self.columns if c.number == x.number and c.quantity.startswith("marker_"))
            xyz = np.stack([cells[name] for name in group])
            missing = np.isnan(xyz)
            for name, absent in zip(group, missing, strict=True):
                self._refuse(absent & ~missing.all(axis=0), name, "is empty where the marker's other cells are not")
            at_zero = (xyz == 0.0).all(axis=0)
            self._refuse(at_zero, group[0], "and its neighbours are zero: leave the cells of a missing marker empty")

    def _check_tips(self, cells: dict[str, Floats]) -> None:
        names = [c.name for c in self.columns if c.quantity.startswith("tip")]
        missing = [np.isnan(cells[name]) for name in names]
        for name, absent in zip(names, missing, strict=True):
            self._refuse(absent & ~np.all(missing, axis=0), name, "is empty where the tip's other cells are not")

    def _check_place(self, cells: dict[str, Floats]) -> None:
        """Position and orientation of a row are there whole, or not at all."""
        names = [c.name for c in self.columns if c.quantity in PLACE]
        missing = [np.isnan(cells[name]) for name in names]
        for name, absent in zip(names, missing, strict=True):
            self._refuse(
                absent & ~np.all(missing, axis=0), name, "is empty where the row's other cells of the tool are not"
            )

    def _check_nothing(self, cells: dict[str, Floats]) -> None:
        """A row in which nothing was read says nothing."""
        names = [c.name for c in self.columns if c.quantity in (*TILTS, *PLACE, "link")]
        others = any(c.quantity in ("marker_x", "pixel_u", *CONTACTS) for c in self.columns)
        if names and not others:
            empty = np.all([np.isnan(cells[name]) for name in names], axis=0)
            self._refuse(empty, names[0], "and all other readings are empty: leave the row out")

    def _check_contacts(self, cells: dict[str, Floats]) -> None:
        """One thing holds the tool in every row; a ball bar comes with the length it reads."""
        held = [c.name for c in self.columns if c.quantity in CONTACTS]
        if not held:
            return
        for name in held:
            self._refuse(cells[name] < 0, name, "is negative: give 1, 2, ... or 0 for none", cells[name])
        count = np.sum([cells[name] > 0 for name in held], axis=0)
        self._refuse(count != 1, held[0], "and its neighbours must name the one thing that held the tool, the others 0")
        for length in (c.name for c in self.columns if c.quantity == "bar"):
            bar = next(c.name for c in self.columns if c.quantity == "bar_id")
            wrong = (cells[bar] > 0) & (cells[length] <= 0)
            self._refuse(wrong, length, "is not the length of a ball bar: it must be above 0", cells[length])

    def _check_quaternions(self, cells: dict[str, Floats]) -> None:
        parts = [c.name for c in self.columns if c.quantity in ("qw", "qx", "qy", "qz")]
        if parts:
            norm = np.linalg.norm(np.stack([cells[name] for name in parts]), axis=0)
            wrong = np.abs(norm - 1.0) > QUATERNION_TOLERANCE  # never of one that is missing
            self._refuse(wrong, "qw", "and its neighbours do not form a unit quaternion; their length is", norm)

    def _remember(self, cells: dict[str, Floats]) -> None:
        for column in self._lengths():
            values = cells[column.name] * column.factor
            values = values[~np.isnan(values)]
            if len(values):
                self._low[column.name] = min(self._low.get(column.name, np.inf), float(values.min()))
                self._high[column.name] = max(self._high.get(column.name, -np.inf), float(values.max()))
        if not self._sample:
            joints = [c for c in self.columns if c.quantity == "q"]
            joints.sort(key=lambda c: c.number or 0)
            step = max(1, len(cells[joints[0].name]) // SAMPLE_ROWS)
            q = np.stack([cells[c.name][::step] * c.factor for c in joints], axis=1)
            point = sorted(self._lengths(), key=lambda c: (-1 if c.number is None else c.number, c.quantity))[:3]
            if point:
                points = np.stack([cells[c.name][::step] * c.factor for c in point], axis=1)
                seen = ~np.isnan(points).any(axis=1)
                self._sample.append((q[seen], points[seen]))

    def _lengths(self) -> Iterable[Column]:
        return (c for c in self.columns if c.quantity in ("x", "y", "z") or c.quantity.startswith("marker_"))

    def _check_unit(self, column: Column) -> None:
        """Refuse points that fit the robot in another unit only."""
        factor = core_identify.unit_factor(self.robot, *self._sample[0])
        if factor is None:
            return
        stated = column.name.rpartition("_")[2]
        size = factor * column.factor * 1e3
        unit = next((name for mm, name in UNITS_MM.items() if abs(mm / size - 1.0) < 1e-6), "another unit")
        remedy = f"name the columns _{unit}" if unit in ("m", "mm") else f"multiply them by {factor:.6g}"
        read_as = unit if factor > 1 else "mm"
        others = [name for mm, name in UNITS_MM.items() if factor < 1 and abs(mm * factor - 1.0) < 1e-6]
        seen = "".join(f", or mm declared as {name} in the recording they come from" for name in others if unit != "mm")
        raise ObservationError(
            f"The positions (column {column.name!r} and its neighbours) fit what the joints command only when they are "
            f"multiplied by {factor:.6g}: they look like {unit} declared as {stated}{seen}. Correct the unit ({remedy}; a "
            f"recording is read in the right one with --unit {read_as}), or the robot's lengths.",
            column=column.name,
            factor=factor,
            unit=unit,
        )

    def _refuse(self, wrong: NDArray[np.bool_], name: str, what: str, cells: Floats | None = None) -> None:
        if not wrong.any():
            return
        row = int(np.argmax(wrong))
        value = "" if cells is None else f" ({cells[row]:.9g})"
        number = self.rows + row + 1
        raise ObservationError(f"Row {number}, column {name!r} {what}{value}.", row=number, column=name)


def _refuse_upright(columns: Sequence[Column], robot: Robot) -> None:
    """Refuse readings of the base about an axis that stands upright: an inclinometer does not see those."""
    upright = np.abs(robot.gravity) > UPRIGHT * max(float(np.linalg.norm(robot.gravity)), 1e-9)
    for column in columns:
        if column.number == BASE and upright[TILTS.index(column.quantity)]:
            seen = [f"tilt0{axis}" for axis, hidden in zip("xyz", upright, strict=True) if not hidden]
            raise ObservationError(
                f"Column {column.name!r} is about the vertical of this robot, which no inclinometer sees: leave it out, and "
                f"give {' and '.join(seen)}.",
                column=column.name,
            )


def _optional_quantities(columns: Sequence[Column]) -> frozenset[str]:
    """Quantities that may be missing in some rows, because other sensors measured those."""
    groups = (PLACE, ("link",), TILTS, ("marker_x",), ("pixel_u",))
    kinds = sum(any(c.quantity in group for c in columns) for group in groups)
    return frozenset((*PLACE, "link", *NAMED)) if kinds > 1 else frozenset()


@dataclass
class _Outside:
    column: Column
    joint: Joint
    rows: list[int] = field(default_factory=list)
    count: int = 0
    worst: float = 0.0  # rad or m beyond
    reading: float = 0.0  # the first one, in the column's unit

    @property
    def unit(self) -> str:
        return "mm" if self.joint.kind == "prismatic" else "deg"

    def add_readings(self, first: int, cells: Floats) -> None:
        q = cells * self.column.factor
        beyond = np.maximum(self.joint.lower - q, q - self.joint.upper)
        rows = np.flatnonzero(beyond > TOLERANCE[self.unit])
        if not len(rows):
            return
        if not self.count:
            self.reading = float(cells[rows[0]])
        self.count += len(rows)
        self.rows += (rows[: MOST_ROWS - len(self.rows)] + first).tolist()
        self.worst = max(self.worst, float(beyond[rows].max()))

    @property
    def is_doubtful(self) -> bool:
        """Whether all are so near that the limits may be wrong, and not the rows."""
        return self.worst <= DOUBTFUL[self.unit]

    def limits(self) -> str:
        low, high = self.joint.lower / self.column.factor, self.joint.upper / self.column.factor
        return f"{low:.6g} to {high:.6g} of joint {self.joint.name!r}"

    def describe_violation(self) -> str:
        size = self.worst * (1e3 if self.unit == "mm" else 180.0 / math.pi)
        more = f" and {self.count - SHOWN} more" if self.count > SHOWN else ""
        rows = ", ".join(map(str, self.rows[:SHOWN]))
        return f"column {self.column.name!r} (limits {self.limits()}) row {rows}{more}, by up to {size:.3g} {self.unit}"


class JointLimits:
    """The readings of one upload; `check` every piece, then `finish`."""

    def __init__(self) -> None:
        self._found: dict[str, _Outside] = {}

    def check(self, column: Column, joint: Joint, cells: Floats, first: int) -> None:
        """Look at the next readings of a joint; ``first`` is the number of the first row."""
        self._found.setdefault(column.name, _Outside(column, joint)).add_readings(first, cells)

    def finish(self) -> tuple[FindingDocument, ...]:
        """Return a warning about readings a little outside the limits; refuse others.

        Raises:
            ObservationError: readings far outside the limits; all columns and rows are named.

        """
        found = [one for one in self._found.values() if one.count]
        if not found:
            return ()
        rows = sorted({row for one in found for row in one.rows})[:MOST_ROWS]
        listed = "; ".join(one.describe_violation() for one in found)
        if all(one.is_doubtful for one in found):
            what = f"Readings are a little outside the limits of their joints: {listed}. "
            what += "They count. Correct the limits of the robot, or leave these rows out."
            return (FindingDocument.make(BEYOND_LIMITS, what, rows=rows),)
        first = min(found, key=lambda one: one.rows[0])
        count = sum(one.count for one in found)
        remedy = "correct the row or the robot" if count == 1 else "correct the rows or the robot"
        radians = [f"{one.column.name[:-3]}deg" for one in found if one.column.name.endswith("_rad")]
        if radians:
            remedy += f", or name the column{'s' if len(radians) > 1 else ''} {', '.join(radians)} if these are degrees"
        if count == 1:
            what = f"Row {rows[0]}, column {first.column.name!r} is outside the limits {first.limits()}: {remedy} "
            what += f"({first.reading:.9g})."
        else:
            what = (
                f"{count} readings are outside the limits of their joints: {listed}. {remedy[0].upper()}{remedy[1:]}."
            )
        raise ObservationError(what, row=rows[0], column=first.column.name, rows=rows)


def payload_warning(robot: Robot, payload_kg: float, where: str) -> FindingDocument | None:
    """Return the warning about a payload, None where an arm of this size may carry it."""
    most, why = heaviest_likely_payload(robot)
    if not payload_kg > most:
        return None
    what = (
        f"{where} is {payload_kg:.6g} kg, but {why}. Is it in grams? Then divide it by 1000 ({payload_kg / 1e3:.4g} kg) "
        'or write unit = "g" in the column map, and upload the rows as a new campaign.'
    )
    return FindingDocument.make(UNLIKELY, what)


class PayloadSize:
    """The payloads of one upload: take every piece, then ask for `warnings`."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._largest: tuple[float, str] = (0.0, "")

    def add_payloads(self, column: Column, cells: Floats) -> None:
        """Remember the largest payload of the next rows."""
        self._largest = max(self._largest, (float(np.nanmax(cells, initial=0.0)) * column.factor, column.name))

    def warnings(self) -> tuple[FindingDocument, ...]:
        """Return the warning about the largest payload, if there is one."""
        found = payload_warning(self._robot, self._largest[0], f"The payload (column {self._largest[1]!r})")
        return () if found is None else (found,)
