"""Whether observations belong to the robot: a mix-up is named when it explains them far better than any physics could.

The size of a residual alone proves no mix-up. A compliant arm, a home-made one or a fit that did not end leave a lot, and yet
no exchange of columns makes it small. A mix-up is certain when undoing it takes the residual of the registration (base and
tool alone) down by ``FACTOR`` and to less than ``GOOD`` of the workspace: geometry and loads leave that in the right
reading too, and in a wrong one nothing but chance takes a fifth.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from kilter_core.errors import FindingDocument, ObservationError
from kilter_core.identify.plausibility.believable import believable, find_lacking, reach
from kilter_core.identify.plausibility.mix_ups import LENGTHS, MixUp, mix_ups
from kilter_core.identify.plausibility.orientation_mix_ups import rotation_faults
from kilter_core.identify.plausibility.set_up_changes import ROWS, Placed, Sample, place
from kilter_core.measurement import Measurement
from kilter_core.measurement.markers import equal_markers
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import Floats

SHUFFLES = 5
FAR = 0.03  # share of the workspace below which errors of an arm may leave it
SHARE = 0.5  # of what shuffled rows leave: rows that belong together leave less
OF_REACH = 0.1  # more than this is left by no arm that is the one described
MOVED_M = 0.02  # rms distance of points and flange from their middle, below which nothing is told
STEPS = 8
DIFFERENCE_RAD = 1e-5
FARTHEST_RAD, FARTHEST_M = np.radians(30.0), 0.1  # by which a zero is off that was mastered, badly
EXPLAINED = 0.2  # share of the residual that joint zeros may leave and still explain it


@dataclass(frozen=True)
class Misfit:
    """What base and tool leave (m) of the rows, and of the same rows shuffled; what the description lacks, in words."""

    left: float
    shuffled: float
    lacking: str = ""

    @property
    def belongs(self) -> bool:
        """Whether joints and positions belong together: shuffled rows leave far more, or one transform explains them."""
        return bool(self.lacking) or self.left <= SHARE * self.shuffled


def find_misfit(sample: Sample) -> Misfit | None:
    """What rows leave that are not of the arm described; None where zeros of the joints or errors of an arm explain it."""
    left = sample.fitted_placement.size
    if (
        sample.spread < MOVED_M
        or left < FAR * sample.spread
        or with_zeros(sample).fitted_placement.size < EXPLAINED * left
    ):
        return None
    shuffled, lacking = _residual_of_shuffled_rows(sample), find_lacking(sample)
    if lacking.left <= EXPLAINED * left:
        return Misfit(left, shuffled, lacking.words)
    fits = left <= SHARE * shuffled and left <= OF_REACH * reach(sample.begin.robot)
    return None if fits else Misfit(left, shuffled)


def _residual_of_shuffled_rows(sample: Sample) -> float:
    rng = np.random.default_rng(0)
    shuffled = [sample.flange[rng.permutation(len(sample))] for _ in range(SHUFFLES)]
    return float(np.median([place(flange, sample.points).size for flange in shuffled]))


def mastered_otherwise(sample: Sample, left: float) -> bool:
    """Whether other zeros of the joints leave no more than ``left`` m: then the arm was mastered wrong, and nothing mixed up.

    A reading in which a joint hardly moves lets the tool take up the zero of the joint before it, so a wrong zero may look
    like another unit.
    """
    found = with_zeros(sample)
    moved = np.abs(found.q[0] - sample.q[0])
    turns = np.array([joint.kind == "revolute" for joint in sample.begin.robot.joints])
    return found.fitted_placement.size <= left and bool(np.all(moved <= np.where(turns, FARTHEST_RAD, FARTHEST_M)))


def with_zeros(sample: Sample) -> Sample:
    """The sample with the zeros of the joints fitted too, from where they are."""
    now = sample
    for _ in range(STEPS):
        changed = _step_joint_zeros(now)
        if changed.fitted_placement.size >= 0.999 * now.fitted_placement.size:
            break
        now = changed
    return now


def _step_joint_zeros(sample: Sample) -> Sample:
    """The sample after one damped step in the zeros of its joints, base and tool following."""
    n, placed = sample.q.shape[1], sample.fitted_placement
    here = placed.predict_points(sample.flange)
    columns = [
        (_points_after_joint_step(sample, _joint_step(n, k)) - here).reshape(-1) / DIFFERENCE_RAD for k in range(n)
    ]
    frames = [_frame(sample, k) for k in range(9)]
    J = np.column_stack([*columns, *frames])
    r = (sample.points - here).reshape(-1)
    H = J.T @ J
    x = np.linalg.solve(H + 1e-6 * np.trace(H) / len(H) * np.eye(len(H)), J.T @ r)
    tried = [replace(sample, q=sample.q + share * x[:n]) for share in (1.0, 0.5, 0.25)]
    return min(tried, key=lambda s: s.fitted_placement.size)


def _joint_step(n: int, k: int) -> Floats:
    return np.asarray(DIFFERENCE_RAD * np.eye(n)[k])


def _points_after_joint_step(sample: Sample, by: Floats) -> Floats:
    """Points (K, 3) of the placed sample with its joints moved."""
    seen = sample.begin.predict(Observations(q=sample.q + by))
    flange = np.tile(np.eye(4), (len(sample), 1, 1))
    flange[:, :3, :3], flange[:, :3, 3] = seen.rotation, seen.position
    return sample.fitted_placement.predict_points(flange)


def _frame(sample: Sample, k: int) -> Floats:
    """Derivative (3 K,) of the placed points by a number of the base (rotation, place) or of the tool point."""
    placed, axis = sample.fitted_placement, np.eye(3)[k % 3]
    if k < 3:
        return np.asarray(np.cross(axis, placed.predict_points(sample.flange) - placed.place).reshape(-1))
    if k < 6:
        return np.tile(axis, len(sample))
    return np.asarray((placed.rotation @ sample.flange[:, :3, :3] @ axis).reshape(-1))


FOREIGN = "foreign_observations"
FEWEST_POSES = 12  # distinct poses below which nine numbers of base and tool can imitate too much
NEAR_M = 1e-3  # registration of a real arm that is not looked at further,
NEAR = 0.005  # or this share of the workspace
FACTOR = 5.0
PAIRS = 4.0  # times that for two mix-ups together: among thousands of readings chance has more to offer
GOOD = 0.1  # share of the workspace that the right reading may leave
ALIKE = 1.5  # readings so near the best one are named with it
SEEDS = 5
HOPELESS = 0.7  # share of the residual that a reading may leave before it is refined
NOTHING: Mapping[str, float] = MappingProxyType({})
CHANGED_M = 0.02  # a base or tool that moves by less in a campaign is a shift that effects describe


@dataclass(frozen=True)
class Finding:
    """Mix-ups (or-ed) that explain the rows, and the registration's residual m with and without them.

    ``moved`` is by how much (m) base or tool changed, where that is what explains them; ``read`` the rows without the
    mix-up, where it is one.
    """

    sentences: tuple[str, ...]
    remedies: tuple[str, ...]
    before: float
    after: float
    moved: float | None = None
    read: Sample | None = None


def refuse_foreign(begin: Calibration, measurement: Measurement) -> tuple[FindingDocument, ...]:
    """Look for mix-ups of joints, units, signs, zeros, conventions and tools; return warnings about the orientation.

    Raises:
        ObservationError: ``foreign_observations``, with what looks wrong, how much it explains, and the remedy.

    """
    o = measurement.observations
    if o.position is None and o.markers is None:
        return ()
    copied = tuple(_duplicate_marker_warnings(o.markers))
    sample = Sample.from_measurement(begin, measurement)
    if len(sample) < FEWEST_POSES:
        return copied
    found = _diagnose_mix_up(sample) or _find_frame_change(sample) or _diagnose_partial_mix_up(sample)
    if found is not None and not _explained_otherwise(sample, found):
        moved = {} if found.moved is None else {"moved_mm": mm(found.moved)}
        _refuse(found.sentences, found.remedies, mm(found.before), mm(found.after), "mm", moved)
    odd = (*copied, *_description_warnings(sample))
    if sample.rotations is None or _has_gross_misfit(sample):
        return odd
    accused, warnings = rotation_faults(sample, o.rotation is not None)
    if accused is not None:
        _refuse(*accused, "deg")
    return (*odd, *warnings)


def _explained_otherwise(sample: Sample, found: Finding) -> bool:
    """Whether other zeros of the joints, or one transform more in the description, explain the rows as well.

    A transform has six numbers to fit: in place of one mix-up it must leave less than one more beside the mix-up does.
    """
    left = ALIKE * found.after
    if mastered_otherwise(sample, left):
        return True
    if found.read is None:
        return find_lacking(sample).left <= left
    if found.after <= max(NEAR_M, NEAR * sample.spread):
        return False
    return find_lacking(sample).left * ALIKE <= find_lacking(found.read).left


def _duplicate_marker_warnings(markers: Floats | None) -> Iterator[FindingDocument]:
    pair = None if markers is None else equal_markers(markers)
    if pair is not None:
        a, b = pair
        yield FindingDocument.make(
            "markers_equal",
            f"Markers {a} and {b} are equal to the last digit in every row: their columns hold one marker twice. "
            f"Correct the columns of one of them in the export or the column map, or leave marker {b} out.",
            markers=[a, b],
        )


def _refuse(
    sentences: tuple[str, ...],
    remedies: tuple[str, ...],
    before: float,
    after: float,
    unit: str,
    more: Mapping[str, float] = NOTHING,
) -> None:
    said = sentences[0] + "".join(f" (or: {s[0].lower()}{s[1:]})" for s in sentences[1:3])
    raise ObservationError(
        f"{said}: with base and tool registered {before:.3g} {unit} are left as the rows are, {after:.3g} {unit} without "
        f"that. Remedy: {'; or '.join(remedies[:3])}.",
        code=FOREIGN,
        looks=list(sentences),
        **{f"before_{unit}": before, f"after_{unit}": after},
        **more,
    )


def _description_warnings(sample: Sample) -> Iterator[FindingDocument]:
    """Warn of a description that does not fit the rows."""
    found = find_misfit(sample) if _has_gross_misfit(sample) else None
    if found is None:
        return
    before, shuffled = mm(found.left), mm(found.shuffled)
    left = f"with base and tool registered {before:.3g} mm are left, {shuffled:.3g} mm with the rows shuffled"
    if not found.belongs:
        raise ObservationError(
            f"Joints and positions do not belong together: {left}, and no mix-up of columns, signs, units, zeros or rows "
            "explains it. Remedy: join each measurement with the joints of its own pose again, by pose number or time, and "
            "check that the robot is the one that was measured.",
            code=FOREIGN,
            looks=["Joints and positions do not belong together"],
            before_mm=before,
            shuffled_mm=shuffled,
        )
    lacks = f"It looks to lack {found.lacking}. " if found.lacking else ""
    yield FindingDocument.make(
        "description_does_not_fit",
        f"The robot's description does not fit the rows: {left}. {lacks}Correct the robot's table or URDF and add "
        "it again.",
        before_mm=before,
        shuffled_mm=shuffled,
    )


def _has_gross_misfit(sample: Sample) -> bool:
    """Whether base and tool alone leave more than real arms do."""
    return sample.fitted_placement.size > max(NEAR_M, NEAR * sample.spread)


def _diagnose_mix_up(sample: Sample) -> Finding | None:
    """The mix-up, or the two together, that explain all rows."""
    if not _has_gross_misfit(sample):
        return None
    known = [m for m in mix_ups(sample.begin.robot) if sample.rotations is not None or not m.inverted]
    hurried = replace(sample, limit=HOPELESS * sample.fitted_placement.size)
    read = [(m, hurried.undo_mix_up(m)) for m in known]
    found = _certain(sample, [((m,), s) for m, s in read])
    if found is not None or sample.fitted_placement.size < FAR * sample.spread:
        return found
    pairs, done = [], set[frozenset[int]]()
    for first in _seeds(sample, read):
        after = hurried.undo_mix_up(first)
        for m in known:
            both = frozenset((id(first), id(m)))
            if len(both) == 2 and both not in done and not (m.rows or first.length != 1.0 != m.length):
                done.add(both)
                pairs.append(((first, m), after.undo_mix_up(m)))
    return _certain(sample, pairs, PAIRS)


def _seeds(sample: Sample, read: list[tuple[MixUp, Sample]]) -> list[MixUp]:
    """Mix-ups worth a second beside them: those that help most, and the unit that the sizes suggest."""
    ratio = _size(sample.flange[:, :3, 3]) / max(_size(sample.points), 1e-12)
    unit = min(LENGTHS, key=lambda row: abs(np.log(row[2] / max(ratio, 1e-12))))[2]
    best = sorted(read, key=lambda pair: _misfit(pair[1]))[:SEEDS]
    return [m for m, _ in best] + [m for m, _ in read if m.length == unit and not any(m is b for b, _ in best)]


def _certain(sample: Sample, read: Sequence[tuple[tuple[MixUp, ...], Sample]], stricter: float = 1.0) -> Finding | None:
    """The best reading, with those about as good, if it is far better than the rows as they are."""
    read = [(ms, s) for ms, s in sorted(read, key=lambda pair: _misfit(pair[1])) if believable(sample, ms, s)]
    if not read:
        return None
    best = read[0][1]
    if _misfit(best) * FACTOR * stricter > _misfit(sample) or _misfit(best) * stricter > GOOD:
        return None
    alike = [ms for ms, s in read if _misfit(s) <= ALIKE * _misfit(best)]
    sentences = tuple(", and ".join(_lower_unless_first(m.sentence, k) for k, m in enumerate(ms)) for ms in alike)
    remedies = tuple("; and ".join(m.remedy for m in ms) for ms in alike)
    before, after = sample.fitted_placement.size, best.fitted_placement.size
    return Finding(sentences, tuple(dict.fromkeys(remedies)), before, after, read=best if len(alike[0]) == 1 else None)


def _misfit(sample: Sample) -> float:
    """Residual as a share of the workspace: points read a thousand times smaller leave less of anything."""
    return sample.fitted_placement.size / max(_size(sample.points), 1e-12)


def _lower_unless_first(sentence: str, place: int) -> str:
    return sentence if place == 0 else sentence[0].lower() + sentence[1:]


def _find_frame_change(sample: Sample) -> Finding | None:
    """Base or tool that changed once during the campaign, in the order of sessions and time or in that of the rows."""
    if not _has_gross_misfit(sample) or len(sample) < 2 * FEWEST_POSES:
        return None
    by_row = np.argsort(sample.row)
    again = np.any(np.diff(by_row) < 0)
    return _changed_in_order(sample) or (_changed_in_order(sample.select_rows(by_row)) if again else None)


def _changed_in_order(sample: Sample) -> Finding | None:
    cut = min(_cuts(sample), key=lambda k: _fit_two_sides(sample, k)[0])
    cut = _moved_cut(sample, cut)
    size, head, tail = _fit_two_sides(sample, cut)
    if size * FACTOR > sample.fitted_placement.size or size > GOOD * sample.spread:
        return None
    late = sample.select_rows(np.arange(cut, len(sample)))
    moved = float(
        np.sqrt(np.mean(np.sum((head.predict_points(late.flange) - tail.predict_points(late.flange)) ** 2, axis=1)))
    )
    if moved < max(CHANGED_M, 0.02 * sample.spread):
        return None
    what, where = _moved_frame_name(late, head, tail, size), f"row {sample.row[cut] + 1}"
    return Finding(
        (f"{what} looks changed by {mm(moved):.3g} mm from {where} on",),
        ("make a campaign of the rows before and one of those after it, and identify them apart",),
        sample.fitted_placement.size,
        size,
        moved,
    )


def _cuts(sample: Sample) -> list[int]:
    """Places where a campaign may fall in two: between its sessions, else some even ones."""
    ends = [int(k) + 1 for k in np.flatnonzero(np.diff(sample.session))]
    even = [len(sample) * k // 8 for k in range(1, 8)]
    return [k for k in ends + even if FEWEST_POSES <= k <= len(sample) - FEWEST_POSES] or [len(sample) // 2]


def _moved_cut(sample: Sample, cut: int) -> int:
    """The cut where each row goes to the side that places it better."""
    for _ in range(3):
        _, head, tail = _fit_two_sides(sample, cut)
        early, late = (np.sum((sample.points - p.predict_points(sample.flange)) ** 2, axis=1) for p in (head, tail))
        cost = np.concatenate([[0.0], np.cumsum(early - late)])
        cut = int(np.clip(np.argmin(cost), FEWEST_POSES, len(sample) - FEWEST_POSES))
    return cut


def _fit_two_sides(sample: Sample, cut: int) -> tuple[float, Placed, Placed]:
    """Residual of the two sides placed each on its own."""
    sides = [place(sample.flange[a:b], sample.points[a:b]) for a, b in pairwise((0, cut, len(sample)))]
    size = np.sqrt((cut * sides[0].size ** 2 + (len(sample) - cut) * sides[1].size ** 2) / len(sample))
    return float(size), sides[0], sides[1]


def _moved_frame_name(late: Sample, head: Placed, tail: Placed, size: float) -> str:
    """Whether another tool point explains the later rows with the base of the earlier ones, or the other way round."""
    local = (late.points - head.place) @ head.rotation - late.flange[:, :3, 3]
    held = np.einsum("nji,nj->ni", late.flange[:, :3, :3], local)
    tool = float(np.sqrt(np.mean(np.sum((held - np.median(held, axis=0)) ** 2, axis=1))))
    return (
        "The tool"
        if tool < 2.0 * size
        else "The base, or the instrument,"
        if _same_tool(head, tail)
        else "Base or tool"
    )


def _same_tool(head: Placed, tail: Placed) -> bool:
    return float(np.linalg.norm(head.tool - tail.tool)) < CHANGED_M


def _diagnose_partial_mix_up(sample: Sample) -> Finding | None:
    """A mix-up of the first or last rows only, or of one session."""
    if sample.fitted_placement.size < FAR * sample.spread or len(sample) < 2 * FEWEST_POSES:
        return None
    for mixed, rest, where in _partial_samples(sample):
        if rest.fitted_placement.size * FACTOR < sample.fitted_placement.size and not _has_gross_misfit(rest):
            found = _diagnose_mix_up(mixed)
            if found is not None:
                sentences = tuple(f"{s} {where}" for s in found.sentences)
                return Finding(sentences, found.remedies, found.before, found.after)
    return None


def _partial_samples(sample: Sample) -> list[tuple[Sample, Sample, str]]:
    sessions = np.unique(sample.session)
    out = []
    for code in sessions if len(sessions) > 1 else ():
        mine = sample.session == code
        if FEWEST_POSES <= mine.sum() <= len(sample) - FEWEST_POSES:
            place_of = (np.flatnonzero(mine), np.flatnonzero(~mine), f"in session {code}")
            out.append((sample.select_rows(place_of[0]), sample.select_rows(place_of[1]), place_of[2]))
    third = max(FEWEST_POSES, len(sample) // 3)
    rows = np.arange(len(sample))
    out.append((sample.select_rows(rows[-third:]), sample.select_rows(rows[:third]), "in the later rows"))
    out.append((sample.select_rows(rows[:third]), sample.select_rows(rows[-third:]), "in the earlier rows"))
    return out


def _size(points: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


__all__ = ["FOREIGN", "ROWS", "Finding", "refuse_foreign"]
