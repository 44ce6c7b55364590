"""A search in torques from log to report: what the rigid bodies lack, at which joint, how sure, and what it leaves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import ObservationError, OptionError
from kilter_core.motion.effects import Wanted
from kilter_core.motion.fit import (
    ALIKE_COLUMNS,
    OWN_SHARE,
    Fit,
    covariance,
    find_hidden_terms,
    fit_terms,
    joint_weights,
)
from kilter_core.motion.layout import DELAY_STEP_S, Bodies, Known, Layout, Term
from kilter_core.motion.model import TorqueModel
from kilter_core.motion.normal import Equations, form_equations
from kilter_core.motion.record import Log, Part, clipped_rows
from kilter_core.motion.regressor import base_sums, rigid_regressor, stated_numbers
from kilter_core.motion.search import Judged, Split, Tests, judge_terms, search_terms, split_motions
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Progress, unheard

FEWEST_BLOCKS = 20
PUSH = 30.0  # times the usual square of a second, from which something else moved the arm
MOST_PUSHED = 0.1  # of the seconds
PASSES = 3
UNEXPLAINED = 0.33  # of the spread of a torque, left by bodies and friction
DESCRIBED = 0.5  # share of a torque's squares, beside friction, that described links must explain to tell its scale
NO_MEAN = 0.02  # of the spread of a torque, in every motion
NEGATIVE = 5.0  # standard errors below zero of a friction
# Torque that repeats with the angle of a joint: how often per turn, before anything else about it is known.
RIPPLE_ROWS = 20_000
FEWEST_RIPPLE_ROWS = 50
FEWEST_PERIODS = 4.0  # of a ripple that a joint must have passed
LOWEST, HIGHEST = 3, 400  # per turn; slower ones are curves of the joint
LATEST_S = 0.2  # that a delay is looked for
FADE_SHARES = tuple(np.geomspace(0.06, 0.4, 8).tolist())  # of the usual speed, at which breaking loose may have faded
BAND_SHARE = 0.8  # of the cut-off: faster ripples are filtered away at the joint's usual speed


@dataclass(frozen=True)
class MotionOptions:
    """``seed`` chooses the motions that are held out.

    Looked for are the effects ``wanted``, all without any; ``fitted`` ones are in the model whether or not the log shows them.
    """

    seed: int = 0
    wanted: Wanted | None = None
    fitted: bool = False


@dataclass(frozen=True)
class Errors:
    """Root mean squares (n,) N m of what is left of the torques: of rigid bodies, with friction, and of the model found."""

    rigid: Floats
    common: Floats
    found: Floats


@dataclass(frozen=True)
class MotionReport:
    """What a log shows. ``held`` are errors on blocks that no choice saw, whole motions where ``unseen``.

    ``base (p,)`` are base parameters; ``common`` the values of the effects that every model has; ``judged`` what was found.
    ``resting`` and ``clipped`` are joints without a row, and rows that were left out because the drive gave no more.
    ``hidden`` are effects that the bodies and the friction imitate in this log, ``pushed_s`` the seconds left out because
    something leant on the arm, ``unexplained`` joints of whose torque the model leaves a third or more: they took no
    part. ``spread (n,)`` of the torques, N m. ``model`` is what unseen motions bear out, fitted to the whole log.
    ``faint`` are effects that somebody asked for and the log does not show. ``scale (n,)`` is how many times as large the
    torques are as the described masses need, NaN where these explain little; ``without_mean`` says that each motion has none.
    """

    robot: Robot
    held: Errors
    unseen: bool
    motions: int
    seconds: float
    judged: tuple[Judged, ...]
    common: tuple[tuple[Term, Floats], ...]
    base: Floats
    resting: tuple[int, ...]
    clipped: tuple[int, ...]
    hidden: tuple[Term, ...]
    pushed_s: tuple[float, ...]
    unexplained: tuple[int, ...]
    spread: Floats
    model: TorqueModel
    scale: Floats
    without_mean: bool
    faint: tuple[Judged, ...] = ()


def find_missing_torque(
    robot: Robot,
    observations: Observations,
    options: MotionOptions | None = None,
    progress: Progress | None = None,
    held: Sequence[int] = (),
) -> MotionReport:
    """Fit rigid bodies and friction to a log, find what they lack, and judge it on motions that were never used: those of the
    sessions ``held``, where some are named.

    ``observations`` have ``t (N,)`` s, ``q`` and ``tau (N, n)``; a ``session`` for each campaign, in which something else may
    be carried than in the first, beside the ``payload_kg`` that is stated. ``progress(fraction, stage)`` may raise to cancel.

    Raises:
        ObservationError: no clock, no torques, or a log in which no joint moves. TooFewPosesError: no motion of 2 s.
        OptionError: none of the effects wanted can show in this log.

    """
    options, progress = options or MotionOptions(), progress or unheard
    log = Log.from_observations(observations)
    progress(0.05, "rigid bodies and friction")
    layout = Layout.of_log(robot, log)
    first = form_equations(layout, log)
    _refuse_rest(first)
    split, pushed = _set_pushes_aside(first, split_motions(first, options.seed, held))
    weights = joint_weights(first, first.terms, split.train)
    fit = fit_terms(first, first.terms, split.train, weights)
    _refuse_negative_friction(first, fit, split)
    progress(0.3, "what they leave")
    orders, tried = find_orders(log, first, fit)
    delays, fades = find_delays_and_fades(log, first)
    sessions = np.unique(first.session[split.train])[1:].tolist()
    # A fit to late torques has taken the delay into its bodies; what it would be without tells the delay apart.
    in_time = Known.from_values(
        layout, fit_terms(form_equations(layout, log, early_s=delays), first.terms, split.train, weights).theta
    )
    layout = layout.with_candidates(orders, delays, fades, sessions, options.wanted)
    _refuse_unseen(layout, options.wanted)
    choose = _list_asked_terms if options.fitted else search_terms
    known, earlier = in_time, frozenset[Term]()
    for k in range(PASSES):
        equations = form_equations(layout, log, known)
        tests = Tests(tried, len(equations.terms) + len(FADE_SHARES) * len(fades))
        share = _scale_progress(progress, 0.6 + 0.1 * k, 0.6 + 0.1 * (k + 1), "which effects explain it")
        terms = choose(equations, split, weights, tests, share)
        if frozenset(terms) == earlier or not any(term.effect.follows_model for term in terms):
            break
        earlier = frozenset(terms)
        known = Known.from_values(layout, fit_terms(equations, terms, split.train, weights).theta, in_time)
        weights = joint_weights(equations, terms, split.train)
    odd = _find_unexplained(log, equations, split, weights, terms)
    if odd.any():  # they say nothing of the others: a channel without a signal, or one of another joint
        weights = np.where(odd, 0.0, weights)
        terms = choose(equations, split, weights, tests, _scale_progress(progress, 0.85, 0.9, "without them"))
    progress(0.9, "motions that were never used")
    judged = judge_terms(equations, split, weights, terms)
    report = _write_report(log, equations, split, weights, terms, judged, pushed, odd)
    if not options.fitted:
        return report
    shown = {one.term: one.is_shown(tests) for one in judged}
    found, faint = (tuple(one for one in judged if shown[one.term] is side) for side in (True, False))
    return replace(report, judged=found, faint=faint)


def _list_asked_terms(
    equations: Equations, split: Split, weights: Floats, tests: Tests, progress: Callable[[float], None]
) -> list[Term]:
    """All terms of joints that move, chosen by whoever asked for them."""
    del split, tests, progress
    return [term for term in equations.terms if term.effect.common or weights[term.joint] > 0.0]


def _refuse_unseen(layout: Layout, wanted: Wanted | None) -> None:
    missing = set(wanted or ()) - {term.effect.id for term in layout.terms}
    if missing:
        raise OptionError(
            f"{', '.join(sorted(missing))} cannot show in this log: it has no temperature_c, or no joint passed "
            "several periods of a ripple. Leave it out, or record what it needs.",
            option="effects",
        )


def _scale_progress(progress: Progress, low: float, high: float, stage: str) -> Callable[[float], None]:
    return lambda share: progress(low + (high - low) * share, stage)


def _find_unexplained(log: Log, equations: Equations, split: Split, weights: Floats, terms: list[Term]) -> Bools:
    """Joints (n,) of whose torque the model found leaves a third or more."""
    left = equations.rms(fit_terms(equations, terms, split.train, weights).theta, split.train)
    return np.asarray((left > UNEXPLAINED * log.tau.std(axis=0)) & (weights > 0.0))


def _set_pushes_aside(equations: Equations, split: Split) -> tuple[Split, Bools]:
    """Leave out the few seconds in which something leant on the arm: far beyond what is left of all others."""
    pushed = np.zeros(len(equations.motion), dtype=bool)
    for _ in range(PASSES):
        kept = split.without(pushed)
        weights = joint_weights(equations, equations.terms, kept.every)
        fit = fit_terms(equations, equations.terms, kept.every, weights)
        left = equations.losses(fit.theta, weights) / np.maximum(equations.rows, 1)
        usual = np.median(left[kept.every], axis=0)
        pushed = np.any(left > PUSH * np.maximum(usual, 1e-12), axis=1)
        if pushed.mean() > MOST_PUSHED:  # not a contact: the model is wrong
            return split, np.zeros_like(pushed)
    return split.without(pushed), pushed


def _refuse_negative_friction(equations: Equations, fit: Fit, split: Split) -> None:
    """Refuse torques that would speed a joint up: their sign is not that of the joint's motion."""
    spread = np.sqrt(np.maximum(np.diag(covariance(equations, fit, split.train)), 0.0))
    sigma = dict(zip(fit.columns.tolist(), spread.tolist(), strict=True))
    at = {(term.effect.id, term.joint): int(term.columns[0]) for term in equations.terms}
    wrong = [
        j + 1
        for j in range(len(equations.products))
        if fit.theta[at["coulomb", j]] < -NEGATIVE * sigma[at["coulomb", j]] and fit.theta[at["viscous", j]] < 0.0
    ]
    if wrong:
        named = ", ".join(map(str, wrong))
        raise ObservationError(
            f"Friction of {'joint' if len(wrong) == 1 else 'joints'} {named} is negative: torque and position have "
            f"opposite signs there. Change the sign (tau{wrong[0]}_nm), or the order of the joints.",
            code="torque_sign",
            joints=wrong,
        )


def _refuse_rest(equations: Equations) -> None:
    moving = int(np.count_nonzero(equations.rows.any(axis=1)))
    if moving < FEWEST_BLOCKS:
        raise ObservationError(
            f"The joints move for {moving} s of this log, and a search needs {FEWEST_BLOCKS} s: "
            "record motions of all joints.",
            code="log_at_rest",
        )


def _write_report(
    log: Log,
    equations: Equations,
    split: Split,
    weights: Floats,
    terms: list[Term],
    judged: list[Judged],
    pushed: Bools,
    odd: Bools,
) -> MotionReport:
    common = [term for term in terms if term.effect.common]
    whole = fit_terms(equations, terms, split.every, weights)
    borne_out = _choose_borne_out_terms(equations, split, weights, judged)
    rms = [_compute_held_rms(equations, split, weights, model) for model in ([], common, borne_out)]
    rows = equations.rows.sum(axis=0)
    return MotionReport(
        equations.layout.robot,
        Errors(*rms),
        split.whole,
        len(np.unique(equations.motion)),
        float(len(equations.motion)),
        tuple(judged),
        tuple((term, whole.theta[term.columns]) for term in common if weights[term.joint] > 0.0),
        whole.theta[: equations.base],
        tuple(np.flatnonzero(rows == 0).tolist()),
        tuple(np.count_nonzero(clipped_rows(log.tau), axis=0).tolist()),
        tuple(
            find_hidden_terms(
                equations, whole, split.every, [t for t in equations.terms if _could_be_named(t, terms, weights)]
            )
        ),
        tuple(equations.start_s[pushed].tolist()),
        tuple(np.flatnonzero(odd).tolist()),
        log.tau.std(axis=0),
        TorqueModel.from_fit(
            equations,
            fit_terms(equations, borne_out, split.every, weights),
            borne_out,
            np.flatnonzero((rows > 0) & (weights > 0.0)).tolist(),
            split.every,
        ),
        _compare_with_description(equations, split.every),
        _has_no_mean(log, equations.layout.robot),
    )


def _compare_with_description(equations: Equations, blocks: Bools) -> Floats:
    """How many times the torque that the described links need is in that of each joint (n,), beside offset and friction."""
    robot, stated = equations.layout.robot, np.zeros(equations.layout.width)
    stated[: equations.base] = base_sums(robot) @ stated_numbers(robot)
    out = np.full(robot.n_joints, np.nan)
    for j, places in enumerate(equations.places):
        common = [t.columns for t in equations.terms if t.joint == j and t.effect.common]
        T = np.zeros((len(places) + 1, len(common) + 2))
        T[:-1, : len(common)] = places[:, None] == np.concatenate(common)
        T[:-1, -2], T[-1, -1] = stated[places], 1.0
        (own, along), (_, whole) = _remove_columns(T.T @ equations.products[j][blocks].sum(axis=0) @ T, len(common))
        if along**2 > DESCRIBED * own * whole > 0.0:
            out[j] = along / own
    return out


def _has_no_mean(log: Log, robot: Robot) -> bool:
    """Whether the torques that gravity has a part in have no mean in any of several motions: it was taken off, or filtered."""
    still = np.zeros_like(log.observations.q[:1])
    pulled = np.abs(rigid_regressor(robot, still + 0.5, still, still)[0]).max(axis=1) > 1e-9
    means = [
        np.abs(log.tau[k:end].mean(axis=0)) / np.maximum(log.tau[k:end].std(axis=0), 1e-12)
        for k, end in log.stretches()
    ]
    return len(means) > 1 and int(np.count_nonzero(pulled)) > 1 and float(np.max(np.array(means)[:, pulled])) < NO_MEAN


def _choose_borne_out_terms(equations: Equations, split: Split, weights: Floats, judged: list[Judged]) -> list[Term]:
    """Return the common terms and those found that held-out blocks bear out, so that these are never left worse."""
    common = [term for term in equations.terms if term.effect.common]
    found = sorted((one for one in judged if one.verdict != "contradicted"), key=lambda one: -one.unseen)
    bare = _sum_held_loss(equations, split, weights, common)
    while found and _sum_held_loss(equations, split, weights, [*common, *(one.term for one in found)]) > bare:
        found.pop()
    return [*common, *(one.term for one in found)]


def _sum_held_loss(equations: Equations, split: Split, weights: Floats, terms: list[Term]) -> float:
    fit = fit_terms(equations, terms, split.train, weights)
    return float(equations.losses(fit.theta, weights, split.held).sum())


def _could_be_named(term: Term, model: list[Term], weights: Floats) -> bool:
    return term not in model and weights[term.joint] > 0.0


def _compute_held_rms(equations: Equations, split: Split, weights: Floats, terms: list[Term]) -> Floats:
    fit = fit_terms(equations, terms, split.train, weights)
    return equations.rms(fit.theta, split.held)


def orders_tried(robot: Robot, j: int, speed: float, cut_off_hz: float) -> Floats:
    """Orders per turn that can be seen at a joint: whole ones, and those of its gear."""
    highest = min(HIGHEST, BAND_SHARE * cut_off_hz * 2.0 * np.pi / max(0.5 * speed, 1e-6))
    whole = np.arange(LOWEST, max(LOWEST, int(highest)), dtype=np.float64)
    ratio = robot.joints[j].gear_ratio
    return whole if ratio is None else np.unique(np.concatenate([whole, [abs(ratio), 2.0 * abs(ratio)]]))


def find_orders(log: Log, equations: Equations, fit: Fit) -> tuple[tuple[float | None, ...], int]:
    """Return the order at which what a fit leaves of each joint repeats most, None where none can be seen, and how many
    were tried in all.
    """
    robot = equations.layout.robot
    best: list[float | None] = []
    tried = 0
    for j, (q, left) in enumerate(_list_residuals(log, equations, fit)):
        orders = np.zeros(0)
        if len(q) >= FEWEST_RIPPLE_ROWS and robot.joints[j].kind == "revolute":
            orders = orders_tried(robot, j, float(equations.layout.speeds[j]), log.cut_off_hz)
            orders = orders[orders * np.ptp(q) > FEWEST_PERIODS * 2.0 * np.pi]
        tried += len(orders)
        power = [_measure_ripple(order, q, left) for order in orders.tolist()]
        best.append(float(orders[int(np.argmax(power))]) if power else None)
    return tuple(best), tried


def _measure_ripple(order: float, q: Floats, r: Floats) -> float:
    waves = np.stack([np.sin(order * q), np.cos(order * q)], axis=1)
    along = waves.T @ r
    return float(along @ np.linalg.pinv(waves.T @ waves) @ along)


def _first_parts(log: Log, layout: Layout) -> Iterator[tuple[Part, Bodies, Bools]]:
    """Parts of a log, until they have :data:`RIPPLE_ROWS` rows; what all joints share, and which rows of each joint count."""
    rows = 0
    for part in log.parts():
        use = (part.moving & part.usable)[part.rows]
        yield part, layout.bodies(part), use
        rows += len(use)
        if rows > RIPPLE_ROWS:
            return


def _list_residuals(log: Log, equations: Equations, fit: Fit) -> list[Floats]:
    """Angles and what is left of the torques (2, N) of each joint where it moves."""
    layout = equations.layout
    found: list[list[Floats]] = [[] for _ in equations.products]
    for part, bodies, use in _first_parts(log, layout):
        for j, one in enumerate(found):
            model = layout.joint_columns(part, bodies, j, None) @ fit.theta[equations.places[j]]
            left = part.smooth(part.tau[:, j] - bodies.stated[:, j] - model)
            one.append(np.stack([part.q[part.rows, j], left])[:, use[:, j]])
    return [np.concatenate(one, axis=1) for one in found]


def find_delays_and_fades(log: Log, equations: Equations) -> tuple[list[float], list[float]]:
    """Return by how much the torque of each joint (n,) looks late, s, never zero; and the speed, rad/s or m/s, at which the
    friction of breaking loose looks faded. Each is what the joint's own columns leave least with.
    """
    layout = equations.layout
    late = np.arange(-LATEST_S, LATEST_S + 0.5 * DELAY_STEP_S, DELAY_STEP_S)
    late = late[np.abs(late) > 0.5 * DELAY_STEP_S]
    fades = np.outer(layout.speeds, FADE_SHARES)
    sums: list[Floats | float] = [0.0] * len(equations.places)
    for part, bodies, use in _first_parts(log, layout):
        at = part.t[part.rows, None] + np.append(late, 0.0)
        for j, own in enumerate(fades.tolist()):
            signals = layout.signals(part, bodies, j, None)
            loose = [replace(signals, fade=fade).fading_column for fade in own]
            model = part.smooth(np.column_stack([layout.joint_columns(part, bodies, j, None), *loose]))
            tau = part.filter_columns(part.tau[:, j] - bodies.stated[:, j])
            both = np.concatenate([model, np.interp(at, part.t, tau)], axis=1)[use[:, j]]
            sums[j] = sums[j] + both.T @ both
    left = [_remove_columns(np.asarray(one), len(k)) for one, k in zip(sums, equations.places, strict=True)]
    loose_at = [_best_column(one[: len(FADE_SHARES), : len(FADE_SHARES)], one[: len(FADE_SHARES), -1]) for one in left]
    late_at = [int(np.argmin(np.diag(one)[len(FADE_SHARES) : -1])) for one in left]
    return late[late_at].tolist(), fades[np.arange(len(fades)), loose_at].tolist()


def _best_column(products: Floats, along: Floats) -> int:
    """Which of some columns explains most alone, by their products and those with what is left."""
    own = np.diag(products)
    return int(np.argmax(np.where(own > OWN_SHARE * own.max(), along**2 / np.where(own > 0.0, own, 1.0), 0.0)))


def _remove_columns(products: Floats, k: int) -> Floats:
    """Products of columns without what the first ``k`` of them explain."""
    A, B = products[:k, :k], products[:k, k:]
    return np.asarray(products[k:, k:] - B.T @ np.linalg.pinv(A, rcond=ALIKE_COLUMNS, hermitian=True) @ B)
