"""From observations to a fit: registration as the start, weights estimated from the residuals, refusals before work."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from kilter_core.errors import OptionError, TooFewPosesError
from kilter_core.identify.carried_masses import of_masses
from kilter_core.identify.fit.least_squares import Fit, Problem, Weights, build_fit, freedom_by_group, solve
from kilter_core.identify.fit.robust import redescend
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.views import with_rig
from kilter_core.measurement import Measurement, Residual
from kilter_core.measurement.frames import register
from kilter_core.measurement.kind import POINTS, TURNS
from kilter_core.model import Calibration, RobotModel
from kilter_core.types import Bools, Floats, Ints, Progress

Sigmas = dict[str, float]
"""Standard deviations by noise group, m or rad."""

Frame = Literal["base", "tool"]
NEW_FRAMES: tuple[tuple[Frame, ...], ...] = ((), ("base",), ("base", "tool"))
START_SIGMA_M = 1e-4
START_SIGMA_RAD = 1e-3
SMALLEST_SIGMA_M = 1e-7  # below any instrument: keeps noise-free simulations solvable
SMALLEST_SIGMA_RAD = 1e-7
WEIGHT_PASSES = 8
HOLDING_PASSES = 2  # passes after which directions are only released: one at the limit would come and go for ever
ROUGH = 0.01  # share of the loss below which a step no longer changes weights that hold to 5 %
UNSEEN = 0.02
PLAIN = 1e8  # square of a singular value up to which rounding of normal equations moves no direction near UNSEEN


def registration_only(start: Calibration, measurement: Measurement, loss: str = "linear") -> Calibration:
    """Fit only base and tool to the measurement, the chain and the effects held: what frame fitting alone can do.

    A loss that lets rows go is not for an arm whose errors are not fitted: Huber's stands in.
    """
    if measurement.tool.places_itself:
        return with_rig(start, measurement)
    options = IdentifyOptions(
        loss=bounded_loss(loss),
        fix=start.names[6 : start.model.n_geometric - 6] + start.names[start.model.n_geometric :],
    )
    return frames_alone(start, measurement, options)


def frames_alone(start: Calibration, measurement: Measurement, options: IdentifyOptions) -> Calibration:
    """Fit frames only, as the options leave them free; a fit that ends further off than the start is not taken."""
    found = estimate(start, measurement, options).calibration()
    return start if _further_off(found, start, measurement) else found


def new_frames(frames: Sequence[str], option: str) -> tuple[Frame, ...]:
    """Return the frames that an option says were set up anew.

    Raises:
        OptionError: a tool without its base: where it was held would pass for an error of the arm.

    """
    found = next((one for one in NEW_FRAMES if list(one) == list(frames)), None)
    if found is None:
        said = ", ".join(map(str, frames))
        raise OptionError(f"{option} is {said}: give base, or base and tool, or leave it out.", option=option)
    return found


def refit_frames(calibration: Calibration, measurement: Measurement, frames: Sequence[str]) -> Calibration:
    """Fit frames, [], ["base"] or ["base", "tool"], anew to other rows, everything else held as it is."""
    if not frames:
        return calibration
    if measurement.tool.places_itself:
        return with_rig(calibration, measurement)
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    held = model.names[6 : model.n_geometric - 6] + model.names[model.n_geometric :]
    options = IdentifyOptions(fix=held, tool="free" if "tool" in frames else "fixed")
    return frames_alone(Calibration(model, values, calibration.marker_points), measurement, options)


def _further_off(found: Calibration, start: Calibration, measurement: Measurement) -> bool:
    """Whether mean and rms of every error are larger than those of the start: a loss may trade one for another."""
    for ours, before in zip(measurement.errors(found), measurement.errors(start), strict=True):
        if ours is None or before is None:
            continue
        sizes = [np.abs(e.reshape(len(e), -1)) for e in (ours, before)]
        far = [(np.linalg.norm(e, axis=1).mean(), np.sqrt(np.mean(e**2))) for e in sizes]
        if not all(a > b for a, b in zip(*far, strict=True)):
            return False
    return True


def bounded_loss(loss: str) -> str:
    """The loss for a model that need not be right: it lets no row go."""
    return "huber" if loss == "tukey" else loss


def estimate(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    progress: Progress | None = None,
    anchor: Floats | None = None,
) -> Fit:
    """Fit the options' free parameters from ``start``, with base and tool registered first.

    The standard deviations of points and rotations are re-estimated from the residuals until they settle, unless
    ``noise_mm`` states the first; stated per-row sigmas are kept and a common variance is added to them. Directions the
    poses do not see stay at ``anchor (P,)``, the start's own values when None.

    Raises:
        TooFewPosesError: fewer measured numbers than free parameters; says how many poses are needed.

    """
    if options.loss == "tukey":
        return _refit_with_tukey_loss(estimate(start, measurement, replace(options, loss="huber"), progress, anchor))
    problem, values = prepare_problem(start, measurement, options, anchor=anchor)
    stated = options.noise_m
    still = problem.anchor if problem.anchor is not None else values[problem.free]
    first = build_fit(problem, values, problem.linearise(values))
    sigmas, held = _predict_unheld_sigmas(first, stated)
    known: Residual | None = first.residual
    walked, rough = 0, True
    for step in range(WEIGHT_PASSES):
        problem = problem.with_weights(_weights(measurement, sigmas), held if len(held) else None)
        fit = solve(problem, values, _iterations(progress, step), known, ROUGH if rough else 0.0)
        walked += fit.iterations
        values, known = fit.values, fit.residual
        left = scatter(fit)
        unobservable = _predict_unheld_sigmas(fit, stated)[1]
        if len(unobservable) > len(held) and step >= HOLDING_PASSES:
            unobservable = held
        settled = all(has_sigma_settled(left[g], sigmas[g]) for g in left) and len(unobservable) == len(held)
        if settled and not rough:
            break
        rough = not settled and step < WEIGHT_PASSES - 2
        if settled:  # weights and directions stay: only the end of the walk is missing
            continue
        sigmas = _bounded_below(left, stated)
        if len(unobservable) != len(held):
            values, held = _restore_unobservable(fit, unobservable, still), unobservable
            known = None if len(unobservable) else known
    return replace(fit, iterations=walked)


def _refit_with_tukey_loss(first: Fit) -> Fit:
    fit, found = redescend(first)
    left_out = int(np.count_nonzero(found.weight == 0.0))
    report = {**first.report, "rows_left_out": left_out}
    return replace(fit, iterations=first.iterations + fit.iterations, report=report)


def _predict_unheld_sigmas(fit: Fit, stated: float | None) -> tuple[Sigmas, Floats]:
    """Sigmas by noise group that a step with nothing held promises, and the directions blind at that scatter.

    Directions are held from the start: along them base, tool and chain trade the same motion on a curved path that no
    step follows far. What counts is the scatter that would be left without holding any: by the scatter of the fit itself
    what is held would decide what is held.
    """
    problem, values = fit.problem, fit.values
    here = problem.linearise(values, fit.residual)
    step = problem.whole_step(values, here)
    moved = problem.apply_step(values, step)
    left = scatter(build_fit(problem, moved, problem.beyond(here, moved, step)))
    sigmas = _bounded_below(left, stated)
    problem = problem.with_weights(_weights(problem.measurement, sigmas), None)
    return sigmas, unobservable_directions(build_fit(problem, values, problem.linearise(values, fit.residual)))


def prepare_problem(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    *,
    registered: bool = False,
    anchor: Floats | None = None,
) -> tuple[Problem, Floats]:
    """The problem with first weights, base and tool registered (unless they are), and the values (P,) to start from.

    Raises:
        TooFewPosesError: fewer measured numbers than free parameters.

    """
    model, values = start.model.absorb_frame_increments(start.values)
    if not measurement.fits_tool:
        options = replace(options, tool="fixed")
    turns = measurement.observes_orientation and not measurement.tool.places_itself
    free = options.free_parameters(model, observes_orientation=turns, observes_base=measurement.observes_base)
    if not registered:
        refuse_too_few(model, measurement, free)
        model = model.in_frames(*_start_frames(model, values, measurement, options, free))
    sigma = START_SIGMA_M if options.noise_m is None else options.noise_m
    weights = Weights(_row_sigmas(measurement, sigma), START_SIGMA_RAD)
    still = (values if anchor is None else anchor)[free]
    if model.of_type is not None:  # what the poses do not see stays where the type has it
        known, own = model.of_type.places([model.names[k] for k in free])
        still[known] = model.of_type.mean[own]
    return Problem(model, measurement, free, weights, options.loss, None, still), values


def _start_frames(
    model: RobotModel, values: Floats, measurement: Measurement, options: IdentifyOptions, free: Ints
) -> tuple[Floats, Floats]:
    """Base and tool (4, 4) to start from. Where the base has no place its registration still finds the tool."""
    o, tool = measurement.observations, _has_free_parameter(model, free, "tool_")
    if o.position is None and o.markers is None:
        return model.T_base, model.T_tool
    if not measurement.observes_base:
        return model.T_base, register(model, values, measurement, tool=tool)[1]
    return register(
        model, values, measurement, base=options.base == "free" and _has_free_parameter(model, free, "base_"), tool=tool
    )


def estimate_weights(fit: Fit, options: IdentifyOptions) -> Weights:
    """Weights that the residuals of a fit call for; ``noise_mm`` states that of the points."""
    stated = options.noise_m
    return _weights(fit.problem.measurement, _bounded_below(scatter(fit), stated))


def _bounded_below(sigmas: Sigmas, stated: float | None) -> Sigmas:
    """Sigmas that no instrument falls short of; that of the points as ``stated`` (m)."""
    out = {group: max(sigma, SMALLEST_SIGMA_RAD) for group, sigma in sigmas.items()}
    return out | {POINTS: stated or max(sigmas[POINTS], SMALLEST_SIGMA_M)}


def _weights(measurement: Measurement, sigmas: Sigmas) -> Weights:
    others = {group: sigma for group, sigma in sigmas.items() if group not in (POINTS, TURNS)}
    return Weights(_row_sigmas(measurement, sigmas[POINTS]), sigmas[TURNS], None, others)


def unobservable_directions(fit: Fit) -> Floats:
    """Directions (K, F), in prior sigmas, whose move by one sigma stays below ``UNSEEN`` of the scatter of each residual.

    What is left unexplained is structured, so it does not average out over rows: a fit that follows it along such a
    direction gains nothing that can be measured and spoils what was not. (UR10 with the tool point on axis 6: positions
    alone rotated the wrist by degrees.) What a type or torques tell is free: how these parameters go together says what rows
    leave open, and held at its mean a zero was off by four of its standard deviations.
    """
    own = np.flatnonzero(~_told_mask(fit))
    scaled = fit.J[:, own] * fit.problem.prior_sigma[own]
    if not len(own):
        return np.zeros((0, len(fit.names)))
    squares, V = np.linalg.eigh(scaled.T @ scaled)
    if squares[-1] < PLAIN:
        s, Vt = np.sqrt(np.maximum(squares, 0.0)), V.T
    else:
        R = np.linalg.qr(scaled, mode="r") if len(scaled) > scaled.shape[1] else scaled
        _, s, Vt = np.linalg.svd(R, full_matrices=True)
        s = np.concatenate([s, np.zeros(scaled.shape[1] - len(s))])
    unseen = s < UNSEEN * math.sqrt(fit.problem.measurement.scalars())
    out = np.zeros((int(unseen.sum()), len(fit.names)))
    out[:, own] = Vt[unseen]
    return out


def _told_mask(fit: Fit) -> Bools:
    """Which of the free parameters (F,) other arms of the type tell, or torques of this one."""
    model = fit.problem.model
    of_type = None if model.of_type is None else model.of_type.restrict_to_identifiable()
    return np.isin(
        fit.names, [name for one in (of_type, model.robot.told_loads) if one is not None for name in one.names]
    )


def _restore_unobservable(fit: Fit, unobservable: Floats, anchor: Floats) -> Floats:
    """Values of the fit with the unobservable directions put back where they started."""
    values = fit.values.copy()
    moved = (values[fit.problem.free] - anchor) / fit.problem.prior_sigma
    values[fit.problem.free] -= (unobservable.T @ (unobservable @ moved)) * fit.problem.prior_sigma
    return values


def refuse_too_few(model: RobotModel, measurement: Measurement, free: Ints) -> None:
    """Raise :class:`TooFewPosesError` unless the distinct poses give at least as many numbers as there are unknowns.

    Masses that are carried as uncertain count as known: their priors say how well. So does what arms of the type say.
    """
    poses, numbers = measurement.poses, measurement.numbers()
    free = free[~of_masses(model)[free]]
    if model.of_type is not None:
        free = np.delete(free, model.of_type.places([model.names[k] for k in free])[0])
    needed = poses + math.ceil((len(free) - numbers) / measurement.equations_per_pose)
    if numbers < len(free):
        raise TooFewPosesError(
            f"{poses} distinct poses give {numbers} numbers for {len(free)} free parameters: at least {needed} poses "
            "are needed, and several times that for a result to trust. Measure more, or fix parameters (level 1, fix).",
            poses=poses,
            needed=needed,
            free=len(free),
        )


def _has_free_parameter(model: RobotModel, free: Ints, prefix: str) -> bool:
    return any(model.names[k].startswith(prefix) for k in free)


def _row_sigmas(measurement: Measurement, common: float) -> float | Floats:
    sigma = measurement.observations.sigma
    if measurement.observations.pose_weight is not None:  # poses weigh themselves
        return common
    if sigma is None or measurement.marker_points is not None or not measurement.observes_base:
        return common
    extra = max(common**2 - float(np.mean(sigma**2)), SMALLEST_SIGMA_M**2)
    return np.asarray(np.sqrt(sigma**2 + extra)[:, None, :])


def scatter(fit: Fit) -> Sigmas:
    """Standard deviations of points (m), rotations (rad, 0 where none are measured) and what was measured beside the tool,
    after the fit, corrected for the parameters used.
    """
    problem = fit.problem
    count = problem.measurement.scalars()
    apart = freedom_by_group(fit)
    freedom = math.sqrt(max(count - fit.effective, 1.0) / count)
    out = {TURNS: 0.0}
    for group in dict.fromkeys(block.group for block in fit.residual.blocks):
        parts = [block.r[~np.isnan(block.r)] for block in fit.residual.blocks if block.group == group]
        left = parts[0] if len(parts) == 1 else np.concatenate(parts)
        size = float(np.sqrt(np.mean(left**2))) if len(left) else 0.0
        if group != TURNS and problem.loss != "linear" and len(left):
            # The median of |residual| over that of a standard normal: outliers must not widen the sigma that bounds them.
            size = float(np.median(np.abs(left)) / 0.6745)
        redundancy = problem.measurement.group_redundancy(group)
        own = math.sqrt(apart[group] * redundancy / len(left)) if group in apart and len(left) else freedom
        out[group] = size * math.sqrt(redundancy) / own
    return out


def has_sigma_settled(new: float, old: float) -> bool:
    """Whether a standard deviation has settled to 5 %."""
    return new == 0.0 or abs(math.log(new / old)) < 0.05


def _iterations(progress: Progress | None, step: int) -> Callable[[int, float], None] | None:
    if progress is None:
        return None

    def report(iteration: int, cost: float) -> None:
        progress(1.0 - 0.7**iteration, f"fit {step + 1}, iteration {iteration}")

    return report
