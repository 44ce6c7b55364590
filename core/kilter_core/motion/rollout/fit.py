"""Output error of a joint: its numbers by least squares on what a simulation of whole episodes leaves (Janot et al. 2014)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from kilter_core.motion.kernels import joint as place
from kilter_core.motion.rollout.effects import Number, RolloutEffect
from kilter_core.motion.rollout.record import SETTLE_S, JointEpisode, JointRecord
from kilter_core.types import Bools, Floats

PRIOR_LOG = 2.3  # a number of the user's model may be wrong by a factor of ten
WORST = 1e3  # sigmas, that a simulation which diverges counts
RESCALED, FAR_LESS = 3, 0.6
DIFFERENCE = 1e-3
EVALUATIONS = 20
LEAST_FRICTION, LEAST_DAMPING = 0.02, 0.02  # of the usual torque (and per usual speed): a fit does not begin at zero
GEAR_DAMPING_S = 0.002  # damping of a gear over its stiffness, to begin with
SLIP_SHARE = 0.05  # of the usual speed, at which breaking loose has faded
STARTS = ((0.0, 0.0), (1e-3, 0.0), (0.0, 2e-2))  # rad and rad/s, by which a start is moved to find its best
DIVERGED_RAD = 3e4  # what a simulation that ran away counts as
BASE = (
    Number("armature", place.ARMATURE, "kg m2", "log", (0.3, 1.0, 3.0)),
    Number("friction", place.FRICTION, "N m", "log", (1.0,)),
    Number("damping", place.DAMPING, "N m s/rad", "log", (1.0,)),
    Number("gain", place.GAIN, "N m/rad", "log", (0.3, 1.0, 3.0)),
)


@dataclass(frozen=True)
class Term:
    """An effect in one of its variants."""

    effect: RolloutEffect
    variant: int = 0


@dataclass(frozen=True)
class JointFit:
    """Numbers ``p (COUNT,)`` of the joint and what they ``left (R,)`` of the readings, rad.

    ``cost`` is the mean square (rad2) on the rows that were fitted; ``jacobian`` is by the ``fitted`` numbers over their
    ``scales``, in units of ``sigma`` over the root of the number of rows.
    """

    terms: tuple[Term, ...]
    p: Floats
    left: Floats
    cost: float
    jacobian: Floats
    fitted: tuple[Number, ...]
    scales: Floats
    sigma: float

    @property
    def values(self) -> dict[str, float]:
        """The numbers of the servo by name, and the sides of the gear that it and the log read."""
        names = {one.name: one.place for one in BASE}
        names |= {"servo_share": place.SERVO_SHARE, "servo_behind": place.BEHIND, "reads_behind": place.READS_BEHIND}
        names |= {"moving_load": place.MOVING_LOAD, "torque_limit": place.TORQUE_LIMIT}
        names |= {"impedance": place.IMPEDANCE, "rate": place.RATE, "gear_damping": place.GEAR_DAMPING}
        return {name: float(self.p[at]) for name, at in names.items()}

    @property
    def names(self) -> list[str]:
        """Names of what was ``fitted``: numbers of the servo, and effects."""
        beside = (number.name for number in _numbers_beside(self.terms))
        return [*(number.name for number in BASE), *(term.effect.id for term in self.terms), *beside]

    @property
    def slip_speed(self) -> float:
        """Speed (rad/s) at which breaking loose has faded."""
        return float(self.p[place.SLIP_SPEED])

    @property
    def creeps(self) -> bool:
        """Whether friction lets the joint creep, as MuJoCo's does."""
        return bool(self.p[place.RATE] > 0.0)


def start_values(record: JointRecord) -> Floats:
    """Numbers of the joint as its model states them, friction and damping off zero, where no step would lead away."""
    p = record.stated.copy()
    p[place.ARMATURE] = max(p[place.ARMATURE], 0.02 * record.inertia, 1e-7)
    p[place.FRICTION] = max(p[place.FRICTION], LEAST_FRICTION * record.usual_torque)
    p[place.DAMPING] = max(p[place.DAMPING], LEAST_DAMPING * record.usual_torque / record.usual_speed)
    p[place.SLIP_SPEED], p[place.GEAR_DAMPING] = SLIP_SHARE * record.usual_speed, GEAR_DAMPING_S
    return p


def simulate(record: JointRecord, p: Floats, episodes: Iterable[int] | None = None) -> Floats:
    """Readings (R,) that a joint with these numbers would give; nan outside ``episodes``."""
    wanted = range(len(record.episodes)) if episodes is None else set(episodes)
    parts = [
        _run(one, p, record.step_s, find_start(record, p, k), len(one.t))
        if k in wanted
        else np.full(len(one.t), np.nan)
        for k, one in enumerate(record.episodes)
    ]
    found = np.concatenate(parts)
    return found if record.correction is None else np.asarray(found + record.correction)


def find_start(record: JointRecord, p: Floats, k: int) -> tuple[float, float]:
    """Angle (rad) and speed (rad/s) with which a joint with these numbers begins the ``k``-th episode.

    They are fitted to the rows in which a start dies out, which nothing else is fitted to or judged by: where a servo is at
    the limit of its torque, nothing takes back what a guessed speed is off.
    """
    one = record.episodes[k]
    rows = max(3, int(np.searchsorted(one.t, one.t[0] + SETTLE_S, side="right")))
    read = one.reading[:rows]
    if record.correction is not None:
        first = sum(len(before.t) for before in record.episodes[:k])
        read = read - record.correction[first : first + rows]
    start = (float(read[0]), float((one.reading[2] - one.reading[0]) / (one.t[2] - one.t[0])))
    runs = [_run(one, p, record.step_s, (start[0] + apart[0], start[1] + apart[1]), rows) for apart in STARTS]
    J = np.column_stack([(run - runs[0]) / np.sum(apart) for run, apart in zip(runs[1:], STARTS[1:], strict=True)])
    if not np.isfinite(J).all():
        return start
    moved = np.linalg.lstsq(J, read - runs[0], rcond=1e-6)[0]
    better = (start[0] + float(moved[0]), start[1] + float(moved[1]))
    squares = [np.sum((read - run) ** 2) for run in (runs[0], _run(one, p, record.step_s, better, rows))]
    return better if squares[1] < squares[0] else start


def _run(one: JointEpisode, p: Floats, step_s: float, start: tuple[float, float], rows: int) -> Floats:
    """The first ``rows`` readings of an episode that begins at this angle with this speed."""
    out = np.full(rows, np.nan)
    out[0], speed = start
    steps = one.bodies.shape[1] if rows == len(one.t) else int((one.t[rows - 1] - one.t[0]) / step_s) + 1
    bodies = np.ascontiguousarray(one.bodies[:, :steps])
    place.simulate_joint(p, one.t[:rows], one.command[:rows], one.sums[:rows], step_s, bodies, speed, out)
    return out


def fit_joint(
    record: JointRecord, terms: Sequence[Term], rows: Bools, sigma: float, begin: Floats, evaluations: int = EVALUATIONS
) -> JointFit:
    """JointFit the servo, and ``terms`` beside it, to some ``rows (R,)``, from the values ``begin (COUNT,)``.

    ``sigma`` (rad) is what a reading is expected to be off; where far less is left, the fit goes on with that.
    """
    fit = _fit_at_noise(record, terms, rows, sigma, begin, evaluations)
    for _ in range(RESCALED):
        left = float(np.sqrt(np.mean(fit.left[rows & record.used] ** 2)))
        if not 0.0 < left < FAR_LESS * fit.sigma:
            break
        fit = _fit_at_noise(record, terms, rows, left, fit.p, evaluations)
    return fit


def _fit_at_noise(
    record: JointRecord, terms: Sequence[Term], rows: Bools, sigma: float, begin: Floats, evaluations: int
) -> JointFit:
    numbers = [*BASE, *(term.effect.number for term in terms), *_numbers_beside(terms)]
    scales = np.array([_scale(record, number) for number in numbers])
    logs = np.array([number.scale == "log" for number in numbers])
    places = np.array([number.place for number in numbers])
    prior = np.log(start_values(record)[places[logs]])
    fixed = begin.copy()
    for term in terms:
        for at, value in term.effect.variants[term.variant].items():
            fixed[at] = value
    rows = rows & record.used
    episodes = np.unique(record.episode[rows]).tolist()
    count = max(int(rows.sum()), 1)

    along = np.eye(len(numbers))
    along[: len(BASE) - 1, len(BASE) - 1] = 1.0  # without a load, only the bodies' inertia says the scale of all four
    ratios = 2.0 * np.eye(len(numbers)) - along  # its inverse

    def numbers_at(x: Floats) -> Floats:
        p, x = fixed.copy(), along @ x
        p[places] = np.where(logs, np.exp(np.clip(x, -30.0, 30.0)), np.clip(x, low, high) * scales)
        return p

    def left_at(x: Floats) -> Floats:
        left = (record.reading - simulate(record, numbers_at(x), episodes))[rows] / sigma
        left = np.clip(np.where(np.isfinite(left), left, WORST), -WORST, WORST)
        return np.asarray(np.concatenate([left, ((along @ x)[logs] - prior) / PRIOR_LOG]) / np.sqrt(count))

    steps = [number.difference / scale for number, scale in zip(numbers, scales, strict=True)]
    usual = np.where(logs, 1.0, [0.2 * abs(number.starts[0]) for number in numbers])

    def jacobian_at(x: Floats) -> Floats:
        here = left_at(x)
        h = np.maximum(steps, DIFFERENCE * np.maximum(np.abs(x), usual))
        return np.stack([(left_at(x + step) - here) / step.sum() for step in np.diag(h)], axis=1)

    low = np.where(logs, -np.inf, [number.low for number in numbers] / scales)
    high = np.where(logs, np.inf, [number.high for number in numbers] / scales)
    x0 = np.where(logs, np.log(np.maximum(begin[places], 1e-12)), begin[places] / scales)
    found = least_squares(
        left_at,
        ratios @ np.clip(x0, low, high),
        jacobian_at,
        method="lm",
        x_scale=usual,
        max_nfev=evaluations,
        ftol=1e-5,
        xtol=1e-5,
        gtol=1e-9,
    )
    p = numbers_at(found.x)
    units = np.where(logs, p[places], scales)
    left = record.reading - simulate(record, p)
    return JointFit(
        tuple(terms),
        p,
        left,
        2.0 * float(found.cost) * sigma**2,
        np.asarray(found.jac @ ratios),
        tuple(numbers),
        units,
        sigma,
    )


def _numbers_beside(terms: Sequence[Term]) -> list[Number]:
    return [number for term in terms for number in term.effect.beside]


def _scale(record: JointRecord, number: Number) -> float:
    return {
        "log": 1.0,
        "s": 1.0,
        "rad": 1.0,
        "share": 1.0,
        "torque": record.usual_torque,
        "rad/torque": 1.0 / record.usual_torque,
    }[number.scale]


def fit_base(record: JointRecord, rows: Bools) -> JointFit:
    """JointFit what every servo has, from several starts: gain and inertia may be wrong by a large factor."""
    start = start_values(record)
    tries = []
    for armature in BASE[0].starts:
        for gain in BASE[3].starts:
            p = start.copy()
            p[place.ARMATURE] *= armature
            p[place.GAIN] *= gain
            tries.append((_mean_square(record, p, rows), p))
    tries.sort(key=lambda one: one[0])
    sigma = max(np.sqrt(tries[0][0]), 1e-6)
    fits = [fit_joint(record, (), rows, sigma, p) for _, p in tries[:3]]
    best = min(fits, key=lambda one: one.cost).p.copy()
    best[place.RATE] = 0.0  # a joint that friction holds stands still: no simulator's creep
    fits.append(fit_joint(record, (), rows, sigma, best))
    return min(fits, key=lambda one: one.cost)


def fit_with(record: JointRecord, fit: JointFit, term: Term, rows: Bools, sigma: float) -> JointFit:
    """JointFit one more term beside those of ``fit``, from the best of its starting values."""
    number = term.effect.number
    scale = _scale(record, number)
    tries = []
    for servo, start in product((fit.p, start_values(record)), number.starts):
        p = fit.p.copy()
        p[[one.place for one in BASE]] = servo[[one.place for one in BASE]]
        for at, value in term.effect.variants[term.variant].items():
            p[at] = value
        p[number.place] = start * scale
        tries.append((_mean_square(record, p, rows), p))
    _, begin = min(tries, key=lambda one: one[0])
    return fit_joint(record, (*fit.terms, term), rows, sigma, begin)


def _mean_square(record: JointRecord, p: Floats, rows: Bools) -> float:
    """Mean square (rad2) that a joint with these numbers leaves on some rows; large where it diverges."""
    rows = rows & record.used
    left = (record.reading - simulate(record, p, np.unique(record.episode[rows]).tolist()))[rows]
    return float(np.mean(np.nan_to_num(np.clip(left, -DIVERGED_RAD, DIVERGED_RAD), nan=DIVERGED_RAD) ** 2))
