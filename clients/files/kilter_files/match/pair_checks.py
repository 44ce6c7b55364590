"""What is refused of rows before they are sent: knocked markers, a knocked body, joints that belong to other markers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.match.clock_checks import Checks
from kilter_files.match.dwells import Thinned
from kilter_files.match.knocks import Knock, knocks_of_frames, knocks_of_rows
from kilter_files.match.lag_evidence import (
    NOISE_MM,
    Registration,
    error_columns,
    fit_arm_errors,
    marker_jacobian,
    register,
    spread,
)
from kilter_files.match.rigid_body import Arm
from kilter_files.tables.recording import Recording
from kilter_files.tables.table import JointLog

EXPLAINED = 0.06  # of the markers' spread that a model may leave where it explains them
WINDOW = (6, 16)
LEAST_ROWS = 8
ROUNDS = 6
FAR = 8.0  # times what the model usually leaves: another pose, not an error of the arm
LEAST_MM = 1.0
CALIBRATED_ROWS = 25

LEAST_STEP_ROWS = 16
LEAST_STEP_MM = 0.25
SURE_F = 8.0
LEAST_FREE = 30
SEEN_SHARE = 0.8


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


# A whole body of markers knocked on its mount: distances stay, but the residual of the robot's model steps at that
# moment.
# Each row is transformed into the tool's frame and reduced to six numbers, shift and rotation of the body from where
# it should. What base, markers and small errors of the arm explain of them is taken off; then a step is sought in
# time.


class Step(NamedTuple):
    """Between two times the body came to sit ``size_mm`` elsewhere on the tool."""

    from_s: float
    to_s: float
    size_mm: float

    def describe_step(self) -> str:
        """Say it in words."""
        when = f"between {self.from_s:.2f} and {self.to_s:.2f} s"
        return f"the markers as a whole moved {self.size_mm:.2f} mm on the tool {when}, by the robot's model"


def find_step(arm: Arm, q: Floats, points: Floats, spans: Floats, start: Registration) -> Step | None:
    """Find the clearest step of the body on the tool; None when there is none, or too few rows to see one."""
    points, start = _together(points, start)
    rows = np.flatnonzero(~np.isnan(points).any(axis=(1, 2)))
    if len(rows) < LEAST_STEP_ROWS:
        return None
    q, points, spans = q[rows], points[rows], spans[rows]
    left, columns, motions = _in_tool(arm, q, points, start)
    n, k = left.shape
    sizes = np.maximum(1.4826 * np.median(np.abs(left - np.median(left, axis=0)), axis=0), 1e-6)
    y = (left / sizes).ravel()
    basis = _basis((columns / sizes[:, None]).reshape(n * k, -1), NOISE_MM / float(np.median(sizes)))
    free = n * k - basis.shape[1] - k
    if free < LEAST_FREE:
        return None
    y = y - basis @ (basis.T @ y)
    best, at, shift = 0.0, 0, np.zeros(k)
    for cut in range(1, n):
        gain, own = _gain(y, basis, n, k, cut)
        if gain > best:
            best, at, shift = gain, cut, own
    rest = max(float(y @ y) - best, 1e-12)
    size = float(np.sqrt(np.mean(np.sum((motions @ (shift * sizes)).reshape(-1, 3) ** 2, axis=1))))
    if best / k / (rest / free) < SURE_F or size < LEAST_STEP_MM:
        return None
    return Step(float(spans[at - 1, 0]), float(spans[at, 1]), size)


def _together(points: Floats, start: Registration) -> tuple[Floats, Registration]:
    """The best-seen markers, as many as most rows show together."""
    seen = ~np.isnan(points[..., 0])
    order = np.argsort(-seen.sum(axis=0), kind="stable")
    counts = [int(seen[:, order[: k + 1]].all(axis=1).sum()) for k in range(len(order))]
    most = max(k for k, count in enumerate(counts) if count >= SEEN_SHARE * counts[0])
    chosen = np.sort(order[: most + 1])
    return points[:, chosen], replace(start, markers=start.markers[chosen])


def _in_tool(arm: Arm, q: Floats, points: Floats, start: Registration) -> tuple[Floats, Floats, Floats]:
    """What is left (n, k) in rigid motions of the body, its columns (n, k, unknowns), and the motions (3m, k)."""
    turns, places = arm.poses(q)
    plain = Registration(start.turn, start.place, start.markers, np.zeros(0))
    found, errors = fit_arm_errors(arm, q, points, plain)
    left = points - found.predict_markers(turns, places, errors)
    columns = marker_jacobian(found, turns, places, errors)
    back = np.swapaxes(found.turn @ turns, 1, 2)
    motions = _rigid(found.markers)
    n = len(q)
    own = np.einsum("nij,nmj->nmi", back, left).reshape(n, -1) @ motions
    turned = np.einsum("nij,nmjp->nmip", back, columns).reshape(n, motions.shape[0], -1)
    return own, np.einsum("ak,nap->nkp", motions, turned), motions


def _rigid(markers: Floats) -> Floats:
    """An orthonormal basis of small rigid motions of the markers: (3 m, 6), fewer where they do not show a rotation."""
    away = markers - markers.mean(axis=0)
    columns = [np.tile(axis, (len(markers), 1)).ravel() for axis in np.eye(3)]
    columns += [np.cross(axis, away).ravel() / 100.0 for axis in np.eye(3)]
    u, s, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    return np.asarray(u[:, s > 1e-3 * s[0]])


def _basis(columns: Floats, held: float) -> Floats:
    """An orthonormal basis of what the unknowns explain; directions that matter less than what holds them do not count."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > max(held, 1e-6 * s[0])])


def _gain(y: Floats, basis: Floats, n: int, k: int, cut: int) -> tuple[float, Floats]:
    """How much of ``y`` a step at ``cut`` explains, and the step."""
    step = np.zeros((n, k, k))
    step[cut:] = np.eye(k)
    columns = step.reshape(n * k, k)
    columns = columns - basis @ (basis.T @ columns)
    square = columns.T @ columns
    values, vectors = np.linalg.eigh(square)
    good = values > 0.05 * min(cut, n - cut)
    if not good.any():
        return 0.0, np.zeros(k)
    side = vectors[:, good].T @ (columns.T @ y)
    return float(np.sum(side**2 / values[good])), vectors[:, good] @ (side / values[good])
