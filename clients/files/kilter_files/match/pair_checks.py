"""What is refused of rows before they are sent: knocked markers, a knocked body, joints that belong to other markers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.match.arm import Arm
from kilter_files.match.body_steps import Step, find_step
from kilter_files.match.clock_checks import Checks
from kilter_files.match.dwells import Thinned
from kilter_files.match.knocks import Knock, knocks_of_frames, knocks_of_rows
from kilter_files.match.lag_evidence import spread
from kilter_files.match.registration import Registration, error_columns, fit_arm_errors, register
from kilter_files.tables.joint_log import JointLog
from kilter_files.tables.recording import Recording

EXPLAINED = 0.06  # of the markers' spread that a model may leave where it explains them
WINDOW = (6, 16)
LEAST_ROWS = 8
ROUNDS = 6
FAR = 8.0  # times what the model usually leaves: another pose, not an error of the arm
LEAST_MM = 1.0
CALIBRATED_ROWS = 25


@dataclass(frozen=True)
class Pairing:
    """What the model leaves in each row, mm (n), what counts as unexplained, and the registration; None: explains nothing."""

    off_mm: Floats
    limit_mm: float
    found: Registration | None
    share: float

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Rows that the model does not explain."""
        return np.asarray(self.off_mm > self.limit_mm)


def check_pairs(arm: Arm, q: Floats, points: Floats) -> Pairing | None:
    """Check joints (n, joints; rad, mm) against markers (n, m, 3); None when there are too few rows to tell.

    The stretch of consecutive rows that one registration explains best is taken to be right, and grown.
    """
    seen = ~np.isnan(points[..., 0]).all(axis=1)
    if seen.sum() < LEAST_ROWS:
        return None
    rows = np.flatnonzero(seen)
    turns, places = arm.poses(q)
    found, share = _best_window(turns, places, points, rows)
    off = _off(points, found.predict_markers(turns, places))
    if share > EXPLAINED:
        return Pairing(off, np.inf, None, share)
    limit = max(EXPLAINED * spread(points), LEAST_MM)
    for _ in range(ROUNDS):
        good = np.flatnonzero(off < limit)
        if len(good) < WINDOW[0]:
            break
        found = register(turns[good], places[good], points[good])
        off = _off(points, found.predict_markers(turns, places))
        limit = max(FAR * float(np.sqrt(np.mean(off[good] ** 2))), LEAST_MM)
    return _sharper(arm, q, points, Pairing(off, limit, found, share))


def _sharper(arm: Arm, q: Floats, points: Floats, first: Pairing) -> Pairing:
    """Fit small errors of the arm too, where the rows allow it, so that a small wrong rotation shows."""
    good = np.flatnonzero(~first.wrong & ~np.isnan(first.off_mm))
    if len(good) < CALIBRATED_ROWS or first.found is None:
        return first
    found, _ = fit_arm_errors(arm, q[good], points[good], first.found)
    off = off_calibrated(arm, q, points, found)
    limit = max(FAR * float(np.sqrt(np.mean(off[good] ** 2))), LEAST_MM)
    return Pairing(off, limit, found, first.share)


def off_calibrated(arm: Arm, q: Floats, points: Floats, found: Registration) -> Floats:
    """Return what a calibrated registration leaves in each row, mm (n)."""
    turns, places = arm.poses(q)
    return _off(points, found.predict_markers(turns, places, error_columns(arm, q, found.in_base(turns, places))))


def _best_window(turns: Floats, places: Floats, points: Floats, rows: NDArray[np.int64]) -> tuple[Registration, float]:
    width = int(np.clip(len(rows) // 4, *WINDOW))
    if points.shape[1] == 1:
        width = min(len(rows), max(width, WINDOW[0] + 2))
    starts = range(0, len(rows) - width + 1, max(1, width // 3))
    tried = [_register_rows(turns, places, points, rows[k : k + width]) for k in starts]
    return min(tried, key=lambda pair: pair[1])


def _register_rows(
    turns: Floats, places: Floats, points: Floats, rows: NDArray[np.int64]
) -> tuple[Registration, float]:
    found = register(turns[rows], places[rows], points[rows])
    off = _off(points[rows], found.predict_markers(turns[rows], places[rows]))
    least = max(spread(points[rows]), 0.3 * spread(points), 1e-9)
    return found, float(np.sqrt(np.mean(off**2))) / least


def _off(points: Floats, predicted: Floats) -> Floats:
    square = np.sum((points - predicted) ** 2, axis=-1)
    seen = ~np.isnan(square)
    count = np.where(seen.any(axis=-1), seen.sum(axis=-1), np.nan)
    return np.asarray(np.sqrt(np.where(seen, square, 0.0).sum(axis=-1) / count))


def fitting_rows(arm: Arm, q: Floats, points: Floats, pairing: Pairing) -> NDArray[np.int64]:
    """Return for each row of markers the joints (row of ``q``) that fit it best, -1 where none fits."""
    assert pairing.found is not None
    turns, places = arm.poses(q)
    plain = Registration(pairing.found.turn, pairing.found.place, pairing.found.markers, np.zeros(0))
    there = plain.predict_markers(turns, places)
    limit = max(2 * pairing.limit_mm, 0.02 * spread(points))
    out = np.full(len(points), -1, dtype=np.int64)
    for i, seen in enumerate(points):
        off = _off(np.broadcast_to(seen, there.shape), there)
        if not np.isnan(off).all() and np.nanmin(off) < limit:
            out[i] = int(np.nanargmin(off))
    return out


NOT_CHECKED = "the pairing was not checked against the robot's model: name the robot with --robot or --model"
MOST_LEFT_OUT = 0.1
# What coordinates are multiplied by to be right, their unit, and the unit they were declared in.
UNITS = ((1e3, "m", "mm"), (1e-3, "mm", "m"), (25.4, "inch", "mm"), (10.0, "cm", "mm"))
SHOWN = 4
SAMPLE = 150

LogTime = Callable[[Floats], Floats]


def refuse_knocks(recording: Recording, points: Floats, spans: Floats, checks: Checks) -> list[str]:
    """Refuse dwells (n, m, 3) in which a marker was knocked; a warning where the person allows it.

    Raises:
        FileError: marker, time and size.

    """
    return _describe_knocks(recording, knocks_of_rows(points, spans), checks)


def refuse_knocks_of_frames(recording: Recording, thinned: Thinned, checks: Checks) -> list[str]:
    """Refuse a recording in motion in which a marker was knocked; a warning where the person allows it.

    Raises:
        FileError: marker, time and size.

    """
    return _describe_knocks(recording, knocks_of_frames(thinned), checks)


def _describe_knocks(recording: Recording, found: list[Knock], checks: Checks) -> list[str]:
    if not found:
        return []
    what = "; ".join(knock.describe_knock(recording.markers) for knock in found[:SHOWN]) + (
        " ..." if len(found) > SHOWN else ""
    )
    names = sorted({recording.markers[k] for knock in found for k in knock.markers})
    without = (
        f"Leave it out (--without {names[0]})" if len(names) == 1 else "Leave out the one that moved (--without NAME)"
    )
    first, last = found[0], found[-1]
    remedy = f"{without}, or match one part: --until {first.from_s:.2f} or --since {last.to_s:.2f}."
    return [checks.refuse(recording.path, what, remedy)]


def refuse_wrong_pairs(
    path: Path,
    log: JointLog,
    rows: NDArray[np.int64],
    points: Floats,
    spans: Floats,
    checks: Checks,
    warnings: list[str],
) -> NDArray[np.int64]:
    """Check rows of the log (-1: none) against markers (n, m, 3) by the robot's model; leave out the few that do not fit.

    Raises:
        FileError: many pairs that the model does not explain, or a body that was knocked.

    """
    if checks.arm is None:
        warnings.append(NOT_CHECKED)
        return rows
    kept = np.flatnonzero(rows >= 0)
    q = checks.arm.reading(log)[rows[kept]]
    pairing = check_pairs(checks.arm, q, points[kept])
    if pairing is None:
        warnings.append(f"fewer than {LEAST_ROWS} rows: the pairing was not checked against the robot's model")
        return rows
    if pairing.found is None or pairing.wrong.sum() > max(2, MOST_LEFT_OUT * len(kept)):
        what, remedy = _explain_wrong_pairs(checks.arm, log, q, points[kept], spans[kept], pairing)
        warnings.append(checks.refuse(path, what, remedy))
        return rows
    out = rows.copy()
    for k in np.flatnonzero(pairing.wrong):
        where = f"dwell {kept[k] + 1} at {spans[kept[k], 0]:.2f} s"
        warnings.append(f"{where} left out: its markers are {pairing.off_mm[k]:.3g} mm from where the model has them")
        out[kept[k]] = -1
    good = ~pairing.wrong
    step = find_step(checks.arm, q[good], points[kept][good], spans[kept][good], pairing.found)
    if step is not None:
        warnings.append(_refuse_step(path, step, checks))
    return out


def refuse_wrong_frames(path: Path, log: JointLog, thinned: Thinned, log_time: LogTime, checks: Checks) -> list[str]:
    """Check a sample of a recording's moments as rows are checked; return warnings.

    Raises:
        FileError: moments that the model does not explain, or a body that was knocked.

    """
    if checks.arm is None:
        return [NOT_CHECKED]
    assert log.t_s is not None
    t = log_time(thinned.t_s)
    with np.errstate(invalid="ignore"):
        usable = np.flatnonzero(
            (t >= log.t_s[0]) & (t <= log.t_s[-1]) & ~np.isnan(thinned.points_mm[..., 0]).any(axis=1)
        )
    at = usable[:: max(1, len(usable) // SAMPLE)]
    q = np.stack([np.interp(t[at], log.t_s, column) for column in checks.arm.reading(log).T], axis=1)
    points, spans = thinned.points_mm[at], np.stack([thinned.t_s[at]] * 2, axis=1)
    pairing = check_pairs(checks.arm, q, points)
    if pairing is None:
        return ["too few frames show all markers: the pairing was not checked against the robot's model"]
    if pairing.found is None or pairing.wrong.sum() > MOST_LEFT_OUT * len(at):
        return [checks.refuse(path, *_explain_wrong_pairs(checks.arm, log, q, points, spans, pairing))]
    good = ~pairing.wrong
    step = find_step(checks.arm, q[good], points[good], spans[good], pairing.found)
    return [] if step is None else [_refuse_step(path, step, checks)]


def _refuse_step(path: Path, step: Step, checks: Checks) -> str:
    remedy = f"Match one part: --until {step.from_s:.2f} or --since {step.to_s:.2f}."
    return checks.refuse(path, step.describe_step(), remedy)


def _fits(arm: Arm, q: Floats, points: Floats) -> bool:
    """Whether the model explains four of five pairs."""
    found = check_pairs(arm, q, points)
    return found is not None and found.found is not None and bool(found.wrong.sum() < 0.2 * len(q))


def _explain_wrong_pairs(
    arm: Arm, log: JointLog, q: Floats, points: Floats, spans: Floats, pairing: Pairing
) -> tuple[str, str]:
    """Say what is wrong with pairs, and the remedy."""
    if _fits(arm, q[::-1], points):
        what = f"the poses of {log.path.name} come in the reverse order of the dwells, by the model of {arm.name}"
        return what, "Reverse the rows of the log."
    unit = next((u for u in UNITS if _fits(arm, q, points * u[0])), None)
    if unit is not None:
        what = f"the model of {arm.name} explains the pairs when coordinates are taken {unit[0]:g} times as large"
        return f"{what}: they look like {unit[1]} declared as {unit[2]}", f"Correct the unit (--unit {unit[1]})."
    if pairing.found is None:
        what = (
            f"the model of {arm.name} explains no stretch of the pairs with {log.path.name}: {pairing.share:.0%} of the "
            f"markers' spread of {spread(points):.0f} mm is left at best"
        )
        remedy = (
            "Are the poses in the order of the dwells, is it this robot, "
            "and are its joints in the right order and direction?"
        )
        return what, remedy
    wrong = np.flatnonzero(pairing.wrong)
    first, last = wrong[0], wrong[-1]
    fits = fitting_rows(arm, q, points, pairing)[wrong]
    what = (
        f"{len(wrong)} of {len(q)} pairs with {log.path.name} are wrong by the model of {arm.name}, dwell {first + 1} at "
        f"{spans[first, 0]:.2f} s to dwell {last + 1} at {spans[last, 0]:.2f} s: their markers are "
        f"{np.nanmedian(pairing.off_mm[wrong]):.3g} mm from where it has them"
    )
    shifts = (fits - wrong)[fits >= 0]
    if len(shifts) > len(wrong) / 2:
        usual = int(np.median(shifts))
        if np.mean(shifts == usual) > 0.7:
            what += f"; they fit the pose {abs(usual)} {'later' if usual > 0 else 'earlier'}"
    return what, "Put the poses in the order of the dwells, or leave those out that were not measured."
