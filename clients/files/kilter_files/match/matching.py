"""A recording joined with its joint log: dwells to poses, in order or by time, or every frame by time."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.ground.later import interpolate
from kilter_files.match.clock_checks import UNTOLD, Checks
from kilter_files.match.clocks import Clocks, Pieces, match_pieces
from kilter_files.match.dwells import Dwell, RestOptions, find_dwells, thin
from kilter_files.match.pair_checks import (
    refuse_knocks,
    refuse_knocks_of_frames,
    refuse_wrong_frames,
    refuse_wrong_pairs,
)
from kilter_files.match.rigid_body import Body, Poses, poses, seen_enough
from kilter_files.tables.recording import Recording
from kilter_files.tables.survey import jumps
from kilter_files.tables.table import JointLog

SAME_POSE_DEG = 0.01
MOVED_DEG = 0.05
OFF_SHAPE_MM = 1.0  # further from the body's shape is not noise: a marker moved, or is another one

Columns = dict[str, Floats]


@dataclass(frozen=True)
class Matched:
    """Contract columns, one row per dwell, and the report of how they were found."""

    columns: Columns
    report: dict[str, Any]


def match_dwells(
    recording: Recording,
    log: JointLog,
    by: str,
    options: RestOptions | None = None,
    body: Body | None = None,
    checks: Checks = UNTOLD,
) -> Matched:
    """Join the dwells of a recording with the poses of a log, ``by`` "order" or "time"; with ``body`` as its poses.

    Raises:
        FileError: counts that differ, motions that do not fit, markers that change places or are knocked, clocks that
            jump, and pairs of markers and joints that the robot's model does not explain.

    """
    refuse_jumps(recording)
    dwells = find_dwells(recording, options or RestOptions())
    if not dwells:
        what = "the markers never rest"
        raise fault(recording.path, what, "Match every frame by time (--by frames), or raise --rest-speed.")
    spans = np.array([[dwell.start_s, dwell.end_s] for dwell in dwells])
    counts = (spans[:, 0] >= checks.since_s) & (spans[:, 1] <= checks.until_s)
    warnings = refuse_knocks(recording, _means(dwells)[counts], spans[counts], checks)
    pieces, told = match_pieces(recording.path, thin(recording), log, checks) if by == "time" else (None, [])
    warnings += told
    rows = _by_order(recording, dwells, log) if pieces is None else _by_time(dwells, log, pieces, warnings)
    rows = np.where(counts, rows, -1)
    if body is not None:
        rows = _of_known_poses(dwells, rows, body, warnings)
    rows = refuse_wrong_pairs(recording.path, log, rows, _means(dwells), spans, checks, warnings)
    kept = [dwell for dwell, row in zip(dwells, rows, strict=True) if row >= 0]
    index = rows[rows >= 0]
    if not len(index):
        raise fault(recording.path, f"none of its {len(dwells)} dwells is left", "; ".join(warnings) + ".")
    return Matched(*_rows(recording, log, kept, index, body, pieces, warnings))


def _rows(
    recording: Recording,
    log: JointLog,
    kept: list[Dwell],
    index: NDArray[np.int64],
    body: Body | None,
    pieces: Pieces | None,
    warnings: list[str],
) -> tuple[Columns, dict[str, Any]]:
    columns = {name: log.columns[name][index] for name in log.joints}
    columns |= {n: v[index] for n, v in log.columns.items() if n not in columns and n not in ("t_s", "pose_id")}
    columns["pose_id"] = log.columns["pose_id"][index] if "pose_id" in log.columns else pose_numbers(log, index)
    columns |= _marker_mean_columns(kept) if body is None else _body_pose_columns(kept, body)
    return columns, _report(recording, log, kept, columns, pieces, warnings)


def _means(dwells: list[Dwell]) -> Floats:
    return np.stack([dwell.mean_mm for dwell in dwells])


def refuse_jumps(recording: Recording) -> None:
    """Refuse a recording in which markers change places, or all columns move over.

    Raises:
        FileError: the first such row.

    """
    before = None
    for block in recording.blocks():
        points = block.points_mm if before is None else np.concatenate([before.points_mm[-1:], block.points_mm])
        rows = block.rows if before is None else np.concatenate([before.rows[-1:], block.rows])
        for row, what in jumps(points, rows, recording.markers):
            where = {"line" if recording.kind.endswith("csv") else "frame": row}
            raise fault(recording.path, what, "Label the markers again, or cut the recording there.", **where)
        before = block


def _by_order(recording: Recording, dwells: list[Dwell], log: JointLog) -> NDArray[np.int64]:
    poses = pose_row_indices(log)
    if len(poses) != len(dwells):
        short = min(dwells, key=lambda d: d.end_s - d.start_s)
        remedy = (
            "Set --shortest, --settle or --rest-speed so that each pose is one dwell, or match by time. The shortest "
            f"dwell is {short.end_s - short.start_s:.2f} s, at {short.start_s:.2f} s."
        )
        raise fault(recording.path, f"{len(dwells)} dwells, but {log.path.name} has {len(poses)} poses", remedy)
    return poses


def pose_row_indices(log: JointLog) -> NDArray[np.int64]:
    """Return the rows of the log that are poses: all, or without repeated rows where nothing moved since the row before."""
    q = log.q_even()
    if log.t_s is None or "pose_id" in log.columns or len(log) < 2:
        return np.arange(len(log))
    changed = np.abs(np.diff(q, axis=0)).max(axis=1) > SAME_POSE_DEG
    return np.arange(len(log)) if changed.all() else _rest_rows(changed)


def _rest_rows(changed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The middle row of every stretch of at least three rows without change."""
    edges = np.flatnonzero(np.concatenate([[True], changed, [True]]))
    spans = [(int(a), int(b)) for a, b in itertools.pairwise(edges) if b - a >= 3]
    return np.array([(a + b) // 2 for a, b in spans], dtype=np.int64)


def _by_time(dwells: list[Dwell], log: JointLog, pieces: Pieces, warnings: list[str]) -> NDArray[np.int64]:
    assert log.t_s is not None
    q, rows = log.q_even(), []
    for k, dwell in enumerate(dwells, 1):
        start, end = pieces.log_time(np.array([dwell.start_s, dwell.end_s]))
        if np.isnan(start) or np.isnan(end) or not pieces.together(dwell.start_s, dwell.end_s):
            warnings.append(f"dwell {k} at {dwell.start_s:.2f} s left out: its place in the log is not sure")
            rows.append(-1)
            continue
        first, after = np.searchsorted(log.t_s, start), np.searchsorted(log.t_s, end, side="right")
        moved = float(np.ptp(q[first:after], axis=0).max()) if after > first else np.inf
        if after <= first or moved > MOVED_DEG:
            said = "the log has no row then" if after <= first else f"the joints moved {moved:.3g} deg meanwhile"
            warnings.append(f"dwell {k} at {dwell.start_s:.2f} s left out: {said}")
        rows.append(int(first + after) // 2 if after > first and moved <= MOVED_DEG else -1)
    return np.array(rows, dtype=np.int64)


def pose_numbers(log: JointLog, index: NDArray[np.int64]) -> Floats:
    """Number the poses from 1 as they come; equal joints (0.01 deg) share a number."""
    known: list[Floats] = []
    out = []
    for q in log.q_even()[index]:
        same = next((k for k, other in enumerate(known) if np.abs(q - other).max() <= SAME_POSE_DEG), None)
        if same is None:
            known.append(q)
        out.append(len(known) if same is None else same + 1)
    return np.array(out, dtype=np.float64)


def _marker_mean_columns(dwells: list[Dwell]) -> Columns:
    mean, sigma = np.stack([d.mean_mm for d in dwells]), np.stack([d.mean_sigma_mm for d in dwells])
    columns = {"t_s": np.array([(d.start_s + d.end_s) / 2 for d in dwells])}
    columns |= marker_columns(mean)
    return columns | {f"s{axis}_mm": np.maximum(sigma[:, i], 1e-6) for i, axis in enumerate("xyz")}


def _of_known_poses(dwells: list[Dwell], rows: NDArray[np.int64], body: Body, warnings: list[str]) -> NDArray[np.int64]:
    """Leave out dwells in which the body's pose is not known, or its markers do not fit its shape."""
    found = poses(body, np.stack([d.mean_mm for d in dwells]))
    usual = float(np.nanquantile(found.rms_mm, 0.25)) if seen_enough(found).any() else 0.0
    bent = found.rms_mm > max(OFF_SHAPE_MM, 5 * usual)
    for k in np.flatnonzero(~seen_enough(found) | bent):
        what = f"its markers are {found.rms_mm[k]:.3g} mm off the body's shape" if bent[k] else "too few markers seen"
        warnings.append(f"dwell {k + 1} at {dwells[k].start_s:.2f} s left out: {what}")
    return np.where(seen_enough(found) & ~bent, rows, -1)


def _body_pose_columns(dwells: list[Dwell], body: Body) -> Columns:
    plain = _marker_mean_columns(dwells)
    columns = pose_columns(poses(body, np.stack([d.mean_mm for d in dwells])))
    return {"t_s": plain["t_s"]} | columns | {name: plain[name] for name in ("sx_mm", "sy_mm", "sz_mm")}


def pose_columns(found: Poses) -> Columns:
    """Return x_mm ... qz of poses."""
    columns = {f"{axis}_mm": found.position_mm[:, i] for i, axis in enumerate("xyz")}
    return columns | {f"q{part}": found.quaternion[:, i] for i, part in enumerate("wxyz")}


def marker_columns(points: Floats) -> Columns:
    """Return m1x_mm ... of points (n, markers, 3)."""
    return {f"m{k + 1}{axis}_mm": points[:, k, i] for k in range(points.shape[1]) for i, axis in enumerate("xyz")}


def _report(
    recording: Recording,
    log: JointLog,
    dwells: list[Dwell],
    columns: Columns,
    pieces: Pieces | None,
    warnings: list[str],
) -> dict[str, Any]:
    scatter = np.stack([d.scatter_mm for d in dwells])
    return {
        "dwells": len(dwells),
        "poses": len(np.unique(columns["pose_id"])),
        "scatter_mm": [round(float(v), 6) for v in np.sqrt(np.nanmean(scatter**2, axis=0))],
        "mean_sigma_mm": [round(float(np.median(columns[f"s{axis}_mm"])), 6) for axis in "xyz"],
        "outliers": sum(d.outliers for d in dwells),
        "clock": None if pieces is None else clock_report(pieces, recording.duration_s),
        "warnings": [*recording.warnings, *log.warnings, *warnings],
    }


def clock_report(pieces: Pieces | Clocks, duration_s: float) -> dict[str, Any]:
    """Return the clocks as a document: offset at the recording's start, drift, uncertainty; with parts, of each."""
    if isinstance(pieces, Pieces):
        if len(pieces.parts) == 1:
            return clock_report(pieces.parts[0][2], duration_s)
        parts = [
            {"from_s": start, "to_s": end} | _clock_segment_report(clocks, start, end)
            for start, end, clocks in pieces.parts
        ]
        return parts[0] | {"parts": parts}
    return _clock_segment_report(pieces, 0.0, duration_s)


def _clock_segment_report(clocks: Clocks, start: float, end: float) -> dict[str, float]:
    return {
        "offset_s": float(clocks.log_time(np.zeros(1))[0]),
        "offset_sigma_s": max(clocks.sigma_s(start), clocks.sigma_s(end)),
        "drift_ppm": clocks.drift * 1e6,
        "drift_sigma_ppm": clocks.drift_sigma * 1e6,
        "correlation": clocks.correlation,
        "frames": clocks.frames,
    }


def frame_rows(
    recording: Recording, log: JointLog, clocks: Clocks | Pieces, body: Body | None = None
) -> Iterator[Columns]:
    """Join every frame with the joints at its time (smooth between rows); frames without a marker are left out."""
    assert log.t_s is not None
    joints = interpolate.CubicSpline(log.t_s, log.q())
    for block in recording.blocks():
        t = clocks.log_time(block.t_s)
        keep = (t >= log.t_s[0]) & (t <= log.t_s[-1]) & ~np.isnan(block.points_mm[..., 0]).all(axis=1)
        if keep.any():
            q = joints(t[keep])
            columns = {"t_s": block.t_s[keep]} | {name: q[:, i] for i, name in enumerate(log.joints)}
            if body is None:
                yield columns | marker_columns(block.points_mm[keep])
                continue
            found = poses(body, block.points_mm[keep])
            known = seen_enough(found) & ~(found.rms_mm > OFF_SHAPE_MM)
            if known.any():
                yield {name: values[known] for name, values in (columns | pose_columns(found)).items()}


def match_frames(recording: Recording, log: JointLog, checks: Checks) -> tuple[Pieces, list[str]]:
    """Match the clocks of a recording whose every frame is to be sent; return warnings too.

    Raises:
        FileError: clocks that jump, markers or a body that were knocked, joints that belong to other markers.

    """
    refuse_jumps(recording)
    thinned = thin(recording)
    warnings = refuse_knocks_of_frames(recording, thinned, checks)
    pieces, told = match_pieces(recording.path, thinned, log, checks)
    warnings += told
    return pieces, warnings + refuse_wrong_frames(recording.path, log, thinned, pieces.log_time, checks)
