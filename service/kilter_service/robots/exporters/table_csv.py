"""The DH or MDH table closest to a version, as CSV that ``kilter robot add`` reads back."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm import STANDARD_GRAVITY, angles_and_lengths
from kilter_core.identify import Predictive, known_zeros
from kilter_core.model import ClosestTable, closest_table
from kilter_core.transforms import rotation_between, xyz_rpy_from_pose
from kilter_service.ground.naming import text_cell
from kilter_service.robots.exporters.exportable import (
    Exportable,
    Written,
    away_from_the_cut,
    distance,
    left_out,
    masses_as_stated,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from kilter_core.arm import Joint, Link, Row
    from kilter_core.identify import KnownZeros
    from kilter_core.model import ClosestTable

ZERO_SIGN = (
    "Zero offsets: real = reading + offset; a controller that subtracts its offset takes the negative. Enter either these "
    "and the nominal theta_offset_deg (d_mm of a prismatic joint), or the table as it is, never both."
)


ZERO_STATES = (
    "States of zeros: known, the 95 % interval leaves 0 out; uncertain, it does not; held, the zero was not identified "
    "or is shared with base or tool; unstated, the version does not say how well it is known; shared, it goes with other "
    "numbers of the table, and a nominal arm with it entered is farther from the real one: take the table as it is."
)


class Change(NamedTuple):
    """A number of the table: nominal, as exported, and the difference; None of an angle that says one rotation with others."""

    where: str
    name: str
    nominal: float
    exported: float
    difference: float | None


def changes(table: ClosestTable, joints: Sequence[Joint]) -> Iterator[Change]:
    """Every number of base, rows and tool."""
    yield from _of_frame("base", table.nominal_base, table.base)
    for joint, nominal, row in zip(joints, table.nominal, table.rows, strict=True):
        before = dict(angles_and_lengths(nominal))
        for name, value in angles_and_lengths(row):
            if value is not None:
                apart = value - (before[name] or 0.0)
                turns = name.endswith("_deg")
                yield Change(
                    joint.name, name, before[name] or 0.0, value, math.remainder(apart, 360.0) if turns else apart
                )
    yield from _of_frame("tool", table.nominal_tool, table.tool)


class ZeroOffset(NamedTuple):
    """How far a joint's zero is off, in ``unit``, with the half width of its 95 % interval; NaN where nobody knows it."""

    joint: str
    unit: str
    offset: float
    half_width: float
    held: bool
    shared: bool = False

    @property
    def state(self) -> str:
        """``known``: the interval leaves 0 out; ``uncertain``; ``held``: not identified; ``unstated``; ``shared``: keep out."""
        if self.shared:
            return "shared"
        if self.held:
            return "held"
        if math.isnan(self.half_width):
            return "unstated"
        return "known" if abs(self.offset) > self.half_width else "uncertain"


def zero_offsets(table: ClosestTable, joints: Sequence[Joint], known: KnownZeros | None) -> Iterator[ZeroOffset]:
    """How far each joint's zero is off, and how well that is known."""
    numbers = {joint.name: k for k, joint in enumerate(joints)}
    wanted = {joint.name: "d_mm" if joint.kind == "prismatic" else "theta_offset_deg" for joint in joints}
    for change in changes(table, joints):
        if wanted.get(change.where) == change.name and change.difference is not None:
            k, unit = numbers[change.where], change.name.rpartition("_")[2]
            half = math.nan if known is None else float(known.half_width[k])
            half = 1e3 * half if unit == "mm" else math.degrees(half)
            held, shared = known is not None and bool(known.held[k]), table.shared is not None and bool(table.shared[k])
            yield ZeroOffset(change.where, unit, change.difference, half, held, shared)


def change_comments(table: ClosestTable, joints: Sequence[Joint], known: KnownZeros | None) -> Iterator[str]:
    """Both as comments of a table."""
    if table.zeros is None:
        yield (
            "Numbers, nominal and exported. The rows have another form than the nominal ones: what lies between two of their "
            "numbers says nothing of the arm, only the poses of all of them do."
        )
    else:
        yield "Numbers, nominal and exported; what the measurements do not tell is as the version has it, which is nominal."
    for change in changes(table, joints):
        numbers = f"nominal={_format_rounded(change.nominal)} exported={_format_rounded(change.exported)}"
        apart = "" if change.difference is None else f" difference={_format_rounded(change.difference)}"
        yield f"number {_word(change.where)} {change.name} {numbers}{apart}"
    yield ZERO_SIGN
    yield ZERO_STATES
    for one in zero_offsets(table, joints, known):
        half = "" if math.isnan(one.half_width) else f" half_width_{one.unit}={_format_rounded(one.half_width)}"
        yield f"zero_offset {_word(one.joint)} {one.unit}={_format_rounded(one.offset)}{half} state={one.state}"


def _of_frame(where: str, nominal: NDArray[np.float64], exported: NDArray[np.float64]) -> Iterator[Change]:
    """The numbers of a frame, of its angles those next to the nominal ones, and by how much it is rotated."""
    xyz, rpy = xyz_rpy_from_pose(nominal)
    rpy = away_from_the_cut(rpy)
    moved, turned = xyz_rpy_from_pose(exported, rpy)
    for axis, before, now in zip("xyz", 1e3 * xyz, 1e3 * moved, strict=True):
        yield Change(where, f"{axis}_mm", float(before), float(now), float(now - before))
    for axis, before, now in zip("xyz", np.degrees(rpy), np.degrees(turned), strict=True):
        yield Change(where, f"r{axis}_deg", float(before), float(now), None)
    angle = math.degrees(rotation_between(nominal, exported))
    yield Change(where, "rotation_deg", 0.0, angle, angle)


def _format_rounded(value: float) -> str:
    """A number for a person: a millionth of a millimetre or degree is rounding."""
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".")


def _word(name: str) -> str:
    """A name without blanks or line ends: the comment stays one line of words."""
    return "_".join(name.split())


MASSES = ("mass_kg", "com_x_mm", "com_y_mm", "com_z_mm")
INERTIA = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
LEVEL = 1e-12
WORDS = {"dh": "Tz(d) Rz(theta) Tx(a) Rx(alpha)", "mdh": "Rx(alpha) [Ry(beta)] Tx(a) Rz(theta) Tz(d)"}


def dh_csv(version: Exportable) -> Written:
    """Write the closest table of standard Denavit-Hartenberg parameters."""
    return _table(version, "dh")


def mdh_csv(version: Exportable) -> Written:
    """Write the closest table of modified parameters, with Hayati's beta for parallel axes."""
    return _table(version, "mdh")


def _table(version: Exportable, convention: str) -> Written:
    calibration = version.calibration
    table = closest_table(calibration, convention)
    stated = Predictive.from_document(version.version.covariance.model_dump())
    known = None if stated is None else known_zeros(calibration, table, stated)
    notes = (*left_out(calibration), *masses_as_stated(calibration.robot), distance(table.loss))
    columns = ["theta_offset_deg", "d_mm", "a_mm", "alpha_deg", *(["beta_deg"] if convention == "mdh" else [])]
    out = io.StringIO(newline="")
    out.write(f"# kilter {convention} table, each row {WORDS[convention]}\n")
    out.write(f"# robot {version.version.robot}, version {version.version.id}\n")
    for name in ("base", "tool"):
        out.write(f"# {name} {_frame(getattr(table, name), getattr(table, f'nominal_{name}'))}\n")
    if not np.allclose(table.gravity, (0.0, 0.0, -STANDARD_GRAVITY), rtol=0.0, atol=LEVEL):
        pairs = zip("xyz", table.gravity.tolist(), strict=True)
        out.write(f"# gravity {' '.join(f'{axis}_m_s2={value!r}' for axis, value in pairs)}\n")
    if (load := calibration.robot.load) is not None:
        place = " ".join(f"{axis}_mm={1e3 * value!r}" for axis, value in zip("xyz", load.com, strict=True))
        out.write(f"# load payload_kg={load.mass!r} {place}\n")
    out.writelines(f"# {note}\n" for note in (*notes, *change_comments(table, calibration.robot.joints, known)))
    writer = csv.writer(out, lineterminator="\n")
    limits = _limit_columns(calibration.robot.joints)
    weights = _weight_columns(table.links)
    writer.writerow(["joint", "type", *columns, *limits, *weights])
    writer.writerows(_cells(table, calibration.robot.joints, columns, limits))
    return Written(out.getvalue(), notes)


def _cells(table: ClosestTable, joints: tuple[Joint, ...], columns: list[str], limits: list[str]) -> list[list[str]]:
    weights = [_weights(link) for link in table.links] or [[] for _ in joints]
    return [
        [text_cell(joint.name), joint.kind, *_numbers(row, columns), *(_limit(joint, name) for name in limits), *weight]
        for row, joint, weight in zip(table.rows, joints, weights, strict=True)
    ]


def _weight_columns(links: tuple[Link, ...]) -> list[str]:
    return [*MASSES, *(f"{name}_kg_m2" for name in INERTIA)] if links else []


def _weights(link: Link) -> list[str]:
    numbers = [link.mass, *(1e3 * link.com).tolist(), *(float(link.inertia[at]) for at in INERTIA.values())]
    return [repr(float(number)) for number in numbers]


def _numbers(row: Row, columns: list[str]) -> list[str]:
    cells = dict(angles_and_lengths(row))
    return ["" if cells[name] is None else repr(cells[name]) for name in columns]


def _limit_columns(joints: tuple[Joint, ...]) -> list[str]:
    kinds = {joint.kind for joint in joints}
    units = [unit for kind, unit in (("revolute", "deg"), ("prismatic", "mm")) if kind in kinds]
    return [f"{side}_{unit}" for unit in units for side in ("lower", "upper")]


def _limit(joint: Joint, column: str) -> str:
    side, _, unit = column.partition("_")
    value = float(getattr(joint, side))
    if (unit == "mm") != (joint.kind == "prismatic") or not math.isfinite(value):
        return ""
    return f"{value * 1e3 if unit == 'mm' else math.degrees(value):.12g}"


def _frame(T: NDArray[np.float64], nominal: NDArray[np.float64]) -> str:
    xyz, rpy = xyz_rpy_from_pose(T, away_from_the_cut(xyz_rpy_from_pose(nominal)[1]))
    values = [*((f"{k}_mm", v * 1e3) for k, v in zip("xyz", xyz, strict=True))]
    values += [(f"r{k}_deg", math.degrees(v)) for k, v in zip("xyz", rpy, strict=True)]
    return " ".join(f"{name}={float(value)!r}" for name, value in values)
