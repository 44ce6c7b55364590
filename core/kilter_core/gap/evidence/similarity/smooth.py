"""Smooth errors of one joint: names that are words for a shape, where the joint moved less than one turn.

Over ±75° q, sin q and cos q span every smooth curve, so a hose's torque fits as a scale error and an eccentricity, and a
belt's as an eccentricity. Such a name is kept only where no smooth curve with as many parameters does as well, and where
a curve added to it improves nothing; otherwise the name is "smooth error of joint k", and the names are its members.

With an effect outside the library (a dent, a worn tooth, a loose cable) the nearest physical name fits it in part. So local
bumps of the same joint are tried in place of a curve's name, and one that does as well takes the name away.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.stats import chi2

from kilter_core.effects.physical import joint_numbers
from kilter_core.effects.readings import LocalBump
from kilter_core.effects.unknown import UnknownSmoothCurve
from kilter_core.gap.evidence.similarity.similarity import Alias, correlation
from kilter_core.gap.search.candidates import FAMILY, JOINT, Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.scan import residual_given
from kilter_core.gap.search.select import MARGIN
from kilter_core.gap.search.sources.source import Source
from kilter_core.model import RobotModel
from kilter_core.types import Floats

TURN = 2.0 * np.pi * 0.98  # rad; limits of a full turn leave a little out
ORDERS = (1, 2, 3, 4, 5)
SPANNED = 0.95  # correlation with the curves from which a name is a smooth shape on the range that was moved
SAME_SPACE = 0.9999  # correlation beyond which a curve is the name itself
IMPROVES = 0.01  # chance at which a curve added to a name says that the name is not all
MOST = 6  # parameters of a curve that takes a name's place
EVEN = 0.5  # chance that a name is wrong when its class does as well
BUMP_CENTRES = 12
BUMP_WIDTHS = (0.06, 0.12, 0.25)  # of the joint's range, as standard deviations
FAIR = 2.0  # price of a parameter, Akaike: taking a name away needs less proof than giving one


def is_curve(candidate: Candidate) -> bool:
    """Whether it is a function of each joint's own angle alone, with a cause for a name."""
    first = candidate.effects[0]
    own = candidate.joints is not None and not first.needs and "drivers" not in first.counted
    return own and not candidate.empirical


def own_curve(candidate: Candidate, joints: set[int]) -> bool:
    """Whether it is a shape without a cause, of the angle of one of the joints alone."""
    alone = candidate.empirical and candidate.joints is not None and set(candidate.joints) <= joints
    return alone and all(getattr(e, "partner", None) is None for e in candidate.effects)


def smooth_members(search: SearchResult, place: int) -> tuple[Alias, ...]:
    """The others of the class "smooth error of joint k" where a chosen curve cannot be distinguished from it; else none."""
    candidate = search.selector.scorer.candidates[place]
    if not is_curve(candidate):
        return ()
    view = _View.from_search(search, place)
    smooth = [j for j in candidate.joints or () if view.smooth(j)]
    unsure = [j for j in smooth if view.partial(j)]
    shared = [j for j in unsure if _other_smooth_curves(search, place, j)]
    # A straight line is spanned by itself and by any curve of little bend: over less than a turn it names nothing.
    plain = bool(unsure) and not candidate.effects[0].physical_class(_model(search).robot).shaped
    unnamed = plain or 2 * len(shared) > len(candidate.joints or ()) or view.is_replaceable_by_curves(unsure)
    if not smooth or not (unnamed or view.is_improved_by_curve(smooth)):
        return ()
    joints = unsure or smooth
    return tuple(_members(search, place, joints, _smooth_error_label(joints)))


def _smooth_error_label(joints: Sequence[int]) -> str:
    return f"smooth error of {joint_numbers(joints)}"


def _other_smooth_curves(search: SearchResult, place: int, joint: int) -> list[int]:
    """Other chosen curves that are smooth at the joint."""
    candidates = search.selector.scorer.candidates
    near = [
        k for k in search.chosen if k != place and is_curve(candidates[k]) and joint in (candidates[k].joints or ())
    ]
    return [k for k in near if _View.from_search(search, k).smooth(joint)]


def _members(search: SearchResult, place: int, joints: Sequence[int], name: str) -> list[Alias]:
    """The unknown curve of each joint, then the other names chosen there."""
    candidates, A = search.selector.scorer.candidates, search.problem.A
    own = candidates[place].columns
    made = []
    for j in joints:
        known = [n for n, c in enumerate(candidates) if c.id == UnknownSmoothCurve.id and c.joints == (j,)]
        # A library without it has the class all the same: the name's own place is used for it.
        most = max(known, key=lambda n: len(candidates[n].columns), default=place)
        curve = candidates[most] if known else Candidate(UnknownSmoothCurve.id, (j,), (), JOINT, empirical=True)
        made.append(Alias(most, curve, 0.0, correlation(A, own, curve.columns) if known else 1.0, EVEN, name))
    for k in search.chosen:
        c = candidates[k]
        if k != place and is_curve(c) and c.level != FAMILY and set(c.joints or ()) <= set(joints):
            made.append(Alias(k, c, 0.0, correlation(A, own, c.columns), EVEN, name))
    return made


@dataclass(frozen=True)
class _View:
    """A chosen curve and the data given all else that was chosen: residual ``r (R,)``, ``basis`` of the rest."""

    search: SearchResult
    candidate: Candidate
    q: Floats
    basis: Floats
    r: Floats
    along: Callable[[int], Floats]

    @staticmethod
    def from_search(search: SearchResult, place: int) -> _View:
        rest = search.selector.columns([k for k in search.chosen if k != place])
        problem, candidate = search.problem, search.selector.scorer.candidates[place]
        q = problem.settings.source.batch.q
        return _View(search, candidate, q, problem.basis(rest), residual_given(problem, rest), _rotating(search))

    def partial(self, joint: int) -> bool:
        """Whether a joint moved less than one turn; a prismatic joint never makes one."""
        kind = _model(self.search).robot.joints[joint].kind
        return kind != "revolute" or float(np.ptp(self.q[:, joint])) < TURN

    @property
    def candidate_columns_given_selected(self) -> Floats:
        """Columns (R, d) of the candidate, given the rest."""
        return self._project_and_normalise(self.search.problem.W_raw[:, list(self.candidate.columns)])

    def of_joint(self, joint: int) -> list[int]:
        """Library columns of the candidate at one of its joints."""
        return self._columns_by_joint[joint]

    @property
    def _columns_by_joint(self) -> dict[int, list[int]]:
        count = len(self.candidate.columns) // len(self.candidate.effects)
        at: dict[int, list[int]] = {}
        for n, effect in enumerate(self.candidate.effects):
            for j in effect.joints or ():  # a curve of several waves is several effects of one joint
                at.setdefault(j, []).extend(self.candidate.columns[count * n : count * (n + 1)])
        return at

    def _project_and_normalise(self, columns: Floats) -> Floats:
        left = columns - self.basis @ (self.basis.T @ columns)
        norm = np.linalg.norm(left, axis=0)
        return np.asarray(left / np.where(norm > 0.0, norm, 1.0))

    def curves(self, joint: int, shapes: Floats) -> Floats:
        """Whitened effect (R, K) of rotating the joint by ``shapes (V, K)``, given the rest."""
        along = self.along(joint)
        columns = along[:, :, None] * shapes[:, None, :]
        return self._project_and_normalise(columns.reshape(-1, shapes.shape[1]))

    def smooth(self, joint: int) -> bool:
        """Whether the name is a smooth shape on the range that the joint moved."""
        own = self._project_and_normalise(self.search.problem.W_raw[:, self.of_joint(joint)])
        tier = _orthonormal(self.curves(joint, polynomials(self.q[:, joint])))
        return _share(_orthonormal(own), tier) > SPANNED

    def is_replaceable_by_curves(self, joints: Sequence[int]) -> bool:
        """Whether curves with as many parameters, or fewer, do as well at these joints as the name does (E6)."""
        if not joints:
            return False
        problem, selector = self.search.problem, self.search.selector
        variance = selector.variance(problem.gram, self.search.chosen)
        price = float(np.log(selector.rows))
        kept = [k for j in self.candidate.joints or () if j not in joints for k in self.of_joint(j)]
        basis = (
            _orthonormal(self._project_and_normalise(problem.W_raw[:, kept])) if kept else np.zeros((len(self.r), 0))
        )
        r = self.r - basis @ (basis.T @ self.r)
        named = _orthonormal(_less(self._project_and_normalise(problem.W_raw[:, self._columns(joints)]), basis))
        value = float(np.sum((named.T @ r) ** 2)) / variance - price * named.shape[1]
        curve = 0.0
        for j in joints:
            mine = _orthonormal(_less(self._project_and_normalise(problem.W_raw[:, self.of_joint(j)]), basis))
            pool = _less(self.curves(j, smooth_shapes(self.q[:, j])), basis)
            found = _best(pool, r, mine, variance, price)
            if found is None:
                return False
            curve += found[0]
            # The next joint's curve is judged by what this one leaves.
            r = r - found[1] @ (found[1].T @ r)
        return bool(curve > value - MARGIN)

    def is_improved_by_curve(self, joints: Sequence[int]) -> bool:
        """Whether a smooth curve added to the name still improves the fit, at one of the joints."""
        problem, selector = self.search.problem, self.search.selector
        variance = selector.variance(problem.gram, self.search.chosen)
        own = _orthonormal(self.candidate_columns_given_selected)
        r = self.r - own @ (own.T @ self.r)
        for j in joints:
            more = _orthonormal(_less(self.curves(j, polynomials(self.q[:, j])), own))
            gain = float(np.sum((more.T @ r) ** 2)) / variance
            if more.shape[1] and chi2.sf(gain, more.shape[1]) < IMPROVES / len(joints):
                return True
        return False

    def _columns(self, joints: Sequence[int]) -> list[int]:
        return [k for j in joints for k in self.of_joint(j)]


def polynomials(q: Floats) -> Floats:
    """Legendre polynomials (V, 5) on the range of ``q (V,)``."""
    u = _scale_to_unit_range(q)
    return np.stack([legendre.legval(u, np.eye(m + 1)[m]) for m in ORDERS], axis=1)


def smooth_shapes(q: Floats) -> Floats:
    """Shapes (V, K) that a smooth error may have in few parameters: polynomials, and powers about the middle and zero."""
    u = _scale_to_unit_range(q)
    return np.column_stack([polynomials(q), u**3, q**2, q**3, u * np.abs(u)])


def _scale_to_unit_range(q: Floats) -> Floats:
    half = float(np.ptp(q)) / 2.0
    return np.asarray((q - (q.max() + q.min()) / 2.0) / (half or 1.0))


def _best(pool: Floats, r: Floats, own: Floats, variance: float, price: float) -> tuple[float, Floats] | None:
    """Best value of a set of shapes with as many parameters as ``own (R, d)`` or fewer, and its basis."""
    Q, small = np.linalg.qr(np.column_stack([pool, own, r]))  # few numbers instead of all rows
    pool, own, r = small[:, : pool.shape[1]], small[:, pool.shape[1] : -1], small[:, -1]
    best: tuple[float, Floats] | None = None
    for size in range(1, min(own.shape[1], MOST) + 1):
        for chosen in itertools.combinations(range(pool.shape[1]), size):
            basis = _orthonormal(pool[:, list(chosen)])
            value = float(np.sum((basis.T @ r) ** 2)) / variance - price * basis.shape[1]
            if best is not None and value <= best[0]:
                continue
            if basis.shape[1] == own.shape[1] and _share(basis, own) > SAME_SPACE:
                continue  # it is the name
            best = (value, basis)
    return None if best is None else (best[0], Q @ best[1])


def _rotating(search: SearchResult) -> Callable[[int], Floats]:
    """Whitened change (V, m) of what was measured, per radian that a joint rotates."""
    settings = search.problem.settings
    column = settings.source.joint_columns(search.problem.values)
    return lambda joint: settings.whitening.residual(column(joint))


def _model(search: SearchResult) -> RobotModel:
    return search.problem.settings.source.model


def _less(columns: Floats, basis: Floats) -> Floats:
    return np.asarray(columns - basis @ (basis.T @ columns))


def _share(space: Floats, other: Floats) -> float:
    """Root of the mean share of a space's orthonormal basis that another's holds."""
    return float(np.sqrt(np.sum((other.T @ space) ** 2) / space.shape[1])) if space.shape[1] else 0.0


def _orthonormal(columns: Floats) -> Floats:
    if not columns.shape[1]:
        return columns
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > 1e-4])


def local_bump_test(search: SearchResult, place: int, rows_q: Floats) -> bool:
    """Whether a local bump of the candidate's joint, at its best centre and width, does as well in its place."""
    candidate = search.selector.scorer.candidates[place]
    source = search.problem.settings.source
    if not _is_curve_of_one_joint(candidate) or candidate.id == LocalBump.id or not source.observes_tool:
        return False
    problem, selector = search.problem, search.selector
    rest = selector.columns([k for k in search.chosen if k != place])
    basis = problem.basis(rest)
    r = residual_given(problem, rest)
    variance = selector.variance(problem.gram, search.chosen)
    S = problem.gram.reduction(selector.columns(search.chosen)) - problem.gram.reduction(rest)
    own = S / variance - FAIR * len(candidate.columns)
    (joint,) = candidate.joints or (0,)
    columns = problem.soft(_bump_columns(search, source, joint, rows_q[:, joint]))
    columns = columns - basis @ (basis.T @ columns)
    size = np.sum(columns**2, axis=0)
    seen = size > 1e-6 * size.max(initial=1e-300)
    taken = (columns[:, seen].T @ r) ** 2 / size[seen]
    # Centre and width are chosen too: they are parameters like the height.
    return bool(taken.max(initial=0.0) / variance - 3.0 * FAIR > own)


def _is_curve_of_one_joint(candidate: Candidate) -> bool:
    """Whether it is a function of one joint's own angle, and nothing else."""
    return len(candidate.joints or ()) == 1 and not candidate.effects[0].needs and not candidate.empirical


def _bump_columns(search: SearchResult, source: Source, joint: int, q: Floats) -> Floats:
    """Whitened effect (R, B) of rotating the joint by a bump of one radian, for all bumps."""
    rotated = source.joint_columns(search.problem.values)(joint)
    along = search.problem.settings.whitening.residual(rotated)
    span = max(float(np.ptp(q)), np.finfo(np.float64).tiny)
    centres = np.linspace(q.min(), q.max(), BUMP_CENTRES)
    shapes = [np.exp(-0.5 * ((q - c) / (w * span)) ** 2) for c in centres for w in BUMP_WIDTHS]
    return np.stack([(along * shape[:, None]).reshape(-1) for shape in shapes], axis=1)
