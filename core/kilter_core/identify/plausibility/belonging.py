"""Whether rows belong to a robot: the one question that upload, dry run, page, check, `identify` and `gap` ask alike.

One such row of forty takes a fit, its errors and every verdict with it: the arm is called another one, or its geometry
wrong. Errors of an arm differ from pose to pose by a factor of a few, never by ``BEYOND``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import FindingDocument, ObservationError
from kilter_core.identify.plausibility.plausibility import FACTOR, FOREIGN, refuse_foreign
from kilter_core.identify.plausibility.set_up_changes import Sample, place_nearer, seen_tool
from kilter_core.identify.plausibility.unrelated_views import refuse_unrelated_views
from kilter_core.measurement import Measurement
from kilter_core.measurement.frames import register
from kilter_core.measurement.markers import alike_orders, fit_poses, format_exchanged_markers
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.clock import read_clock
from kilter_core.parameters import DEG, degrees, mm
from kilter_core.transforms import rotation_log
from kilter_core.types import Bools, Floats, Ints

NEAR_RAD = np.radians(15.0)  # of the nominal robot; a swap feigns rotations of 60 degrees and more
LARGE_RAD = np.radians(30.0)
LEAST_ROWS = 6

NEAR_ENCODERS_RAD = np.radians(2.0)  # scatter between the encoders of a joint that is not looked at further
ROWS = 500
FEWEST_VALUES = 3
UNITS = ((1.0, ""), (DEG, "radians declared as degrees"), (np.pi / 180.0, "degrees declared as radians"))


def refuse_feigned_turns(begin: Calibration, measurement: Measurement) -> None:
    """Compare the rotation that each row's markers show with the robot's.

    The markers' middle, which no swap moves, gives the base.

    Raises:
        ObservationError: ``markers_swapped``, with the first row and how many there are.

    """
    o, shape = measurement.observations, measurement.marker_points
    if shape is None or o.markers_of_poses is None:
        return
    if np.count_nonzero(~np.isnan(o.markers_of_poses).any(axis=(1, 2))) < LEAST_ROWS:
        return
    orders = [(order, rotation) for order, rotation in alike_orders(shape) if _angle(rotation[None])[0] > LARGE_RAD]
    if not orders:
        return
    rotations, usable = _tool_rotations(begin, measurement, shape, o.markers_of_poses)
    reference = rotations[_most_common(rotations)]
    off = _angle(reference.T @ rotations)
    feigned = [np.flatnonzero(_angle((reference @ rotation).T @ rotations) < NEAR_RAD) for _, rotation in orders]
    rows, order = max(
        ((rows, order) for rows, (order, _) in zip(feigned, orders, strict=True)), key=lambda pair: len(pair[0])
    )
    if len(rows) and np.count_nonzero(off < NEAR_RAD) + len(rows) > 0.9 * len(rotations):
        place = np.flatnonzero(usable)[rows]
        raise ObservationError(
            f"In {len(rows)} of {len(rotations)} rows, the first is row {place[0] + 1}, the markers show the tool rotated by "
            f"{degrees(off[rows[0]]):.0f} degrees against the robot, as if markers {format_exchanged_markers(order)} "
            "had changed places: "
            "number them the same in all rows, and space them unevenly so that it is noticed at once.",
            code="markers_swapped",
            row=int(place[0]) + 1,
            rows=len(rows),
            order=[k + 1 for k in order],
        )


def _tool_rotations(
    begin: Calibration, measurement: Measurement, shape: Floats, markers: Floats
) -> tuple[Floats, Bools]:
    """Rotation (K, 3, 3) of the marker shape on the flange in every usable row, by the robot as it begins."""
    middle = Measurement.from_observations(_without_rotations(measurement, markers))
    T_base, _ = register(begin.model, begin.values, middle)
    _, rotation, usable = fit_poses(shape, markers)
    bare = begin.model.in_frames(T_base, np.eye(4))
    flange = bare.predict(measurement.observations, begin.values).rotation
    return np.asarray(flange[usable].transpose(0, 2, 1) @ rotation[usable]), usable


def _without_rotations(measurement: Measurement, markers: Floats) -> Observations:
    seen = np.asarray(~np.isnan(markers).any(axis=(1, 2)))
    o = measurement.observations.select(seen)
    return replace(o, markers=None, tip=None, rotation=None, position=markers[seen].mean(axis=1))


def _most_common(rotations: Floats) -> int:
    """The row whose rotation most others share."""
    some = np.arange(len(rotations))[:: max(1, len(rotations) // 200)]
    return int(some[int(np.argmax([np.count_nonzero(_angle(rotations[k].T @ rotations) < NEAR_RAD) for k in some]))])


def _angle(rotations: Floats) -> Floats:
    return np.asarray(np.linalg.norm(rotation_log(rotations), axis=1))


EACH_SIDE = 4  # rows from each side that a joint needs
CERTAIN = 5.0  # standard errors by which the two sides must differ
LEAST = 2e-5  # rad or m between the two sides that is worth a word


def lag_warnings(robot: Robot, rows: Observations) -> list[FindingDocument]:
    """Say of which joints reading less command follows the direction of the motion, and by how much from side to side."""
    if rows.command is None:
        return []
    apart = rows.q - rows.command
    widths = np.array([_width(apart[:, j], side) for j, side in enumerate(_sides(rows).T)])
    found = [int(j) for j in np.flatnonzero(np.abs(widths) > LEAST)]
    if not found:
        return []
    shown = [
        f"{mm(abs(widths[j])):.3g} mm" if robot.joints[j].kind == "prismatic" else f"{degrees(abs(widths[j])):.3g} deg"
        for j in found
    ]
    said = ", ".join(f"joint {j + 1} by {size}" for j, size in zip(found, shown, strict=True))
    return [
        FindingDocument.make(
            "readings_follow_motion",
            f"Reading less command differs between the two directions of motion: {said}. If the arm had not arrived "
            "when its joints were read, or the log is late, this comes out as a backlash of those joints: read them at rest, "
            "or upload the commands as q. If the arm stood still, its servos stop short and the readings are right.",
            joints=[j + 1 for j in found],
        )
    ]


def _sides(rows: Observations) -> Floats:
    """Direction (N, n) in which each joint moved last: as stated, else from the command of the row before."""
    if rows.direction is not None:
        return rows.direction
    assert rows.command is not None
    out = np.zeros_like(rows.q)
    order = read_clock(rows).order
    out[order[1:]] = np.sign(np.diff(rows.command[order], axis=0))
    return out


def _width(apart: Floats, side: Floats) -> float:
    """Difference between the means of the two sides; 0 where it is not certain."""
    there = np.isfinite(apart)
    up, down = apart[there & (side > 0)], apart[there & (side < 0)]
    if min(len(up), len(down)) < EACH_SIDE:
        return 0.0
    error = float(np.sqrt(np.var(up, ddof=1) / len(up) + np.var(down, ddof=1) / len(down)))
    width = float(np.mean(up) - np.mean(down))
    return width if abs(width) > CERTAIN * error else 0.0


WAY_OUT = "If the rows are right all the same, upload them to a new campaign with --unchecked."
# Refusals that judge how rows look, and may be wrong about them; all others say what rows are not.
JUDGEMENTS = (
    "foreign_observations",
    "markers_swapped",
    "corners_misplaced",
    "intrinsics_differ",
    "views_astray",
    "board_scale_differs",
)


def refuse_mixed_up(begin: Calibration, rows: Observations) -> tuple[FindingDocument, ...]:
    """Refuse rows that a mix-up explains far better than physics; return warnings about what only looks odd.

    Give all ``rows`` of a campaign in the order they came, before any are held out: joints of the row above are found
    only where the row above is there. Set-ups of an instrument, each in a frame of its own, are judged one by one. Where
    a person says that rows are right (``unchecked``), what they would be refused for is a warning.

    Raises:
        ObservationError: one of :data:`JUDGEMENTS`, with what looks wrong, how much that explains, and the remedy, which
            was tried; or what is wrong with the columns.

    """
    warnings: list[FindingDocument] = []
    try:
        warnings += _judge_tool(begin, rows)
        if rows.pixels is not None:
            warnings += refuse_unrelated_views(begin, rows)
        refuse_foreign_links(begin.robot, rows)
    except ObservationError as error:
        if error.code not in JUDGEMENTS:
            raise
        if rows.unchecked is None or not rows.unchecked.any():
            raise type(error)(f"{error.message} {WAY_OUT}", code=error.code, **error.context) from error
        warnings.append(FindingDocument.make(error.code, f"{error.message} The rows count all the same (--unchecked)."))
    return (*warnings, *lag_warnings(begin.robot, rows))


def _judge_tool(begin: Calibration, rows: Observations) -> list[FindingDocument]:
    """Refuse rows of an instrument that cannot be of the arm; what only looks odd in them."""
    warnings: list[FindingDocument] = []
    if rows.position is None and rows.markers is None:
        return warnings
    for part in _split_by_setup(rows):
        of_tool = Measurement.from_observations(part, begin.marker_points, held=True).of_tool()
        refuse_feigned_turns(begin, of_tool)
        warnings += [w for w in refuse_foreign(begin, of_tool) if w not in warnings]
    return [*warnings, *astray_warnings(begin, rows)]


def _split_by_setup(rows: Observations) -> list[Observations]:
    if rows.setup is None or len(codes := np.unique(rows.setup)) < 2:
        return [rows]
    return [rows.select(rows.setup == code) for code in codes]


def refuse_foreign_links(robot: Robot, rows: Observations) -> None:
    """Look for link-side columns that are another joint's, of the other sign or in the other unit.

    Raises:
        ObservationError: ``foreign_observations``, with joint, what it looks like, how much that explains, and the remedy.

    """
    if rows.link_q is None:
        return
    for j in range(robot.n_joints):
        seen = np.flatnonzero(~np.isnan(rows.link_q[:, j]))
        if len(seen) < FEWEST_VALUES:
            continue
        some = seen[np.unique(np.linspace(0, len(seen) - 1, min(ROWS, len(seen))).astype(np.int64))]
        q, link = rows.q[some], rows.link_q[some]
        before = _scatter(link[:, j], q[:, j])
        if before <= NEAR_ENCODERS_RAD or np.ptp(link[:, j]) == 0.0:
            continue
        after, k, sign, unit = min(
            (_scatter(link[:, j], q[:, k] * sign / factor), k, sign, words)
            for k in range(q.shape[1])
            for sign in (1.0, -1.0)
            for factor, words in UNITS
        )
        if after * FACTOR > before or np.ptp(q[:, k]) == 0.0:
            continue
        parts = (
            [f"hold joint {k + 1}"] * (k != j)
            + ["count the other way round"] * (sign < 0)
            + [f"be {unit}"] * bool(unit)
        )
        raise ObservationError(
            f"The link-side encoder of joint {j + 1} looks to {' and to '.join(parts)}: the encoders differ by "
            f"{degrees(before):.3g} deg as the rows are, by {degrees(after):.3g} deg without that. Remedy: correct "
            f"column link{j + 1}_deg, or its name, sign and unit in the column map, and upload again.",
            code=FOREIGN,
            joint=robot.joints[j].name,
            before_deg=float(degrees(before)),
            after_deg=float(degrees(after)),
        )


def _scatter(a: Floats, b: Floats) -> float:
    return float(np.std(a - b))


ASTRAY = "rows_astray"
FEWEST = 12  # poses below which base and tool can imitate too much
USUAL = 0.75  # quantile of the distances that stands for the usual row
BEYOND = 20.0  # times that
LEAST_M = 5e-3  # what is nearer a robust loss sets aside
MOST = 0.2  # share of the rows: more of them are not exceptions
NEAR_M = 1e-3  # rms distance of rows among which none hides: they need no second look
SHOWN = 5


def astray_warnings(begin: Calibration, rows: Observations) -> Iterator[FindingDocument]:
    """Name rows (from 1, of those given) that no arm explains; every set-up of the instrument is placed by itself."""
    found: list[tuple[int, float, float]] = []
    for part in _set_ups(rows):
        index, off = _distances(begin, rows, part)
        usual = float(np.quantile(off, USUAL)) if len(off) else 0.0
        far = np.flatnonzero(off > max(BEYOND * usual, LEAST_M))
        if len(far) <= MOST * len(off):
            found += [(int(index[k]) + 1, float(off[k]), usual) for k in far]
    if found:
        others_mm = mm(max(usual for _, _, usual in found))
        yield _astray_warning([(row, mm(off)) for row, off, _ in sorted(found)], others_mm)


def renumber_warnings(warnings: Iterable[FindingDocument], index: Ints) -> Iterator[FindingDocument]:
    """The same warnings of rows that are ``index`` (from 0) of more."""
    for one in warnings:
        if one["code"] == ASTRAY:
            found = [(int(index[row - 1]) + 1, off) for row, off in zip(one["rows"], one["off_mm"], strict=True)]
            yield _astray_warning(found, one["others_mm"])
        else:
            yield one


def of_held_out(warnings: Iterable[FindingDocument]) -> Iterator[FindingDocument]:
    """What is said of rows of a validation: those astray, which are in the errors on held-out rows."""
    for one in warnings:
        if one["code"] == ASTRAY:
            said = f"Of the validation's rows: {one['message'][0].lower()}{one['message'][1:]}"
            yield FindingDocument.make(**one | {"message": said})


def unless_astray(warnings: Iterable[FindingDocument]) -> Iterator[FindingDocument]:
    """The warnings without that of a large residual where rows astray explain it, which no arm has to."""
    said = list(warnings)
    astray = any(one["code"] == ASTRAY for one in said)
    yield from (one for one in said if not (astray and one["code"] == "large_residual"))


def _astray_warning(found: list[tuple[int, float]], others_mm: float) -> FindingDocument:
    shown = ", ".join(f"row {row} by {off:.3g} mm" for row, off in found[:SHOWN])
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return FindingDocument.make(
        ASTRAY,
        f"The tool is not where the joints put it in {shown}{more}, where the others are within {others_mm:.2g} mm. "
        "No arm does that: a reading that was not taken (zeros), the position of another pose, or joints of another. Leave "
        "these rows out of the file and upload it again.",
        rows=[row for row, _ in found],
        off_mm=[off for _, off in found],
        others_mm=others_mm,
    )


def _set_ups(rows: Observations) -> Iterator[Ints]:
    keys = [key for key in (rows.session, rows.setup) if key is not None]
    if not keys:
        yield np.arange(len(rows))
        return
    codes = np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    yield from (np.flatnonzero(codes == code) for code in np.unique(codes))


def _distances(begin: Calibration, rows: Observations, part: Ints) -> tuple[Ints, Floats]:
    """Rows of a set-up whose tool can be told, and how far (m) each is from the arm placed by base and tool alone."""
    whole = Measurement.from_observations(rows.select(part), begin.marker_points, held=True)
    index, tool = part[whole.tool.measured_row_mask()], whole.of_tool()
    sample = Sample.from_measurement(begin, tool) if len(index) >= FEWEST else None
    if sample is None or len(sample) < FEWEST:
        return index[:0], np.zeros(0)
    points, _, use = seen_tool(tool, tool.observations)
    placed = (
        sample.fitted_placement
        if sample.fitted_placement.size <= NEAR_M
        else place_nearer(sample.flange, sample.points, sample.fitted_placement)
    )
    flange = sample.predict_flange(tool.observations.q[use])
    return index[use], np.linalg.norm(points[use] - placed.predict_points(flange), axis=1)
