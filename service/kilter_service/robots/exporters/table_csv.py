"""The DH or MDH table closest to a version, as CSV that ``kilter robot add`` reads back."""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.conversions.tables import angles_and_lengths
from kilter_core.arm.robot import STANDARD_GRAVITY
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.identify.uncertainty.zero_offsets import known_zeros
from kilter_core.model.closest_table import ClosestTable, closest_table
from kilter_core.transforms import xyz_rpy_from_pose
from kilter_service.ground.texts import text_cell
from kilter_service.robots.exporters.changes import change_comments
from kilter_service.robots.exporters.exportable import Exportable, Written
from kilter_service.robots.exporters.omissions import distance, left_out, masses_as_stated
from kilter_service.robots.exporters.urdf_words import away_from_the_cut

if TYPE_CHECKING:
    from kilter_core.arm.conventions import Row
    from kilter_core.arm.robot import Joint, Link

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
