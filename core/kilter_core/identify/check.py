"""What an identification could tell, before it is made: which parameters these poses see, and what would show the others.

Nothing is fitted but the frames to start from: the Jacobian there decides. What is missing is not looked up in a table;
each remedy is tried on the model, and named only when the parameter would then be known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.identify.carried_masses import beside_masses, of_masses
from kilter_core.identify.estimate import START_SIGMA_RAD, prepare_problem
from kilter_core.identify.fit.least_squares import Fit, Problem, Weights, build_fit
from kilter_core.identify.fleet_prior import FleetVersion, of_its_type
from kilter_core.identify.holdout import select_learned_effects
from kilter_core.identify.identifiability import NullDirection, identifiable, null_directions
from kilter_core.identify.measured_rows import Repeats, measurement_for
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.report import known_of_fit, null_rows, still_joints, within_a_turn
from kilter_core.identify.setup_frames import Frames, marginal, of_the_arm
from kilter_core.identify.steps.start import build_start_model, refuse_missing_columns
from kilter_core.identify.uncertainty.predictive import MEASURED
from kilter_core.identify.views import with_cameras
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import Bools, Floats

ASSUMED_M = 5e-5  # standard deviation of a coordinate where neither repeats nor options say it
FEWEST_DRAWN, MOST_DRAWN = 30, 200  # poses that a remedy is tried with: as many as were measured, between these
TENFOLD = 10.0
BOUNDLESS = 1e6  # times all that the remedies bring: what is not seen then is not seen at all
SECOND_KG = 1.0  # the payload that is tried beside those of the rows
TRIED = frozenset(
    {"moments", "direction"}
)  # what the remedies vary; of other columns an effect says itself what shows it

SPREAD = "Measure poses that spread all joints over their ranges (`kilter plan --purpose identify`)."
TURNED = "Measure the orientation of the tool too: three markers, or a pose sensor."
BOTH = "Measure the orientation of the tool too, in poses that spread all joints over their ranges."
LOADED = "Repeat poses with a second payload: the geometry cancels, the load does not."
SIDES = "Approach the same poses from both sides with every joint, and say it in dir1, dir2 and so on."
MORE = "Measure ten times as many poses, or with a third of the noise."
HARDLY = "Even ten times as many poses would not tell it: measure with far less noise, or hold it (`fix`)."
NEVER = "No pose of the tool tells it from the others here: hold it (`fix`), the fit loses nothing by that."


@dataclass(frozen=True)
class Unknown:
    """A parameter that these rows do not tell: why, and what would."""

    name: str
    reason: str
    remedy: str


@dataclass(frozen=True)
class IdentificationCheck:
    """What the rows can tell. ``names`` are the parameters to identify, ``known`` those among them that the rows see.

    ``directions`` stand with the sums that the rows tell, as an identification has them (:func:`null_rows`).
    ``noise`` m is the standard deviation of a coordinate that this was judged with: "stated", from "repeats" or "assumed".
    """

    names: tuple[str, ...]
    known: tuple[str, ...]
    rank: int
    directions: tuple[dict[str, Any], ...]
    unknown: tuple[Unknown, ...]
    noise: float
    noise_source: Literal["stated", "repeats", "assumed"]


def check_identification(
    robot: Robot,
    train: Observations,
    options: IdentifyOptions,
    start: Calibration | None = None,
    fleet: Sequence[FleetVersion] | None = None,
) -> IdentificationCheck:
    """Say what an identification with these options could tell from the rows it would fit.

    What it knows is what the rows add to the prior, that of ``fleet`` where the options ask for it.

    Whether the rows are of this robot is asked of the whole campaign, before rows are held out
    (:func:`kilter_core.identify.plausibility.belonging.refuse_mixed_up`).

    Raises:
        CoreError: what the identification would be refused with.

    """
    begin = build_start_model(robot, train, options, start)
    refuse_missing_columns(begin, train)
    frames = Frames.from_observations(begin, train, options)
    if frames is not None:
        begin, train = frames.in_model(begin), frames.laid(train)
    begin = of_its_type(begin, train, options, fleet)[0]
    measurement = measurement_for(train, options, begin.marker_points)
    begin = select_learned_effects(with_cameras(begin, train, measurement), train, options, None)[0]
    noise, source = _noise(train, options)
    problem, values = prepare_problem(begin, measurement, replace(options, loss="linear", noise_mm=mm(noise)))
    whole = build_fit(problem, values, problem.linearise(values))
    fit = marginal(whole)
    names, prior = fit.names, fit.problem.prior_sigma
    directions = null_directions(*beside_masses(fit))
    asked = ~of_masses(fit.problem.model)[fit.problem.free]
    known = identifiable(fit.sigma, prior) & ~np.isin(names, list(_of_still_joints(fit)))
    return IdentificationCheck(
        names=tuple(name for name, own in zip(names, asked, strict=True) if own),
        known=tuple(name for name, told in zip(names, known & asked, strict=True) if told),
        rank=int(np.count_nonzero(asked)) - sum(d.structural for d in directions),
        directions=tuple(null_rows(directions, replace(known_of_fit(fit.calibration(), fit), fitted=False))),
        unknown=tuple(_unknown(whole, fit, directions, known | ~asked, options)),
        noise=noise,
        noise_source=source,
    )


def _noise(train: Observations, options: IdentifyOptions) -> tuple[float, Literal["stated", "repeats", "assumed"]]:
    if options.noise_m is not None:
        return options.noise_m, "stated"
    found = Repeats.from_observations(train).between
    return (ASSUMED_M, "assumed") if found is None else (found, "repeats")


def _of_still_joints(fit: Fit) -> dict[str, str]:
    """Parameters of joints that never move, with the joint's name: their columns alias their neighbours'."""
    robot = fit.problem.model.robot
    still = {j: robot.joints[j].name for j in still_joints(fit.problem.measurement.observations)}
    return {e.name: still[e.joint] for e in robot.chain.elements if e.name and e.joint in still}


def _unknown(
    whole: Fit, fit: Fit, directions: tuple[NullDirection, ...], known: Bools, options: IdentifyOptions
) -> Iterator[Unknown]:
    """Every parameter that is not known, with the first remedy under which it would be."""
    if known.all():
        return
    remedies, arm = list(_remedies(whole, options)), of_the_arm(whole)
    tried = [(remedy, _identifiable_mask(information)[arm]) for remedy, information in remedies]
    seen_at_all = _identifiable_mask(BOUNDLESS * np.sum([information for _, information in remedies], axis=0))[arm]
    still = _of_still_joints(fit)
    effects = _effect_remedies(fit.problem.model)
    for k in np.flatnonzero(~known):
        name = fit.names[k]
        if name in still:
            remedy = f"Move joint {still[name]} over its range, or hold {name} (`fix`)."
            yield Unknown(name, f"Joint {still[name]} never moves.", remedy)
            continue
        last = effects.get(name, HARDLY if seen_at_all[k] else NEVER)
        remedy = next((said for said, told in tried if told[k]), last)
        yield Unknown(name, _reason(name, directions, fit, int(k)), remedy)


def _reason(name: str, directions: tuple[NullDirection, ...], fit: Fit, k: int) -> str:
    for direction in directions:
        if any(member == name for member, _ in direction.weights):
            return direction.sentence()
    left = float(fit.sigma[k] / fit.problem.prior_sigma[k])
    return f"These poses leave {left:.0%} of what is not known of {name}."


def _effect_remedies(model: RobotModel) -> dict[str, str]:
    """What each effect that reads other columns than the remedies vary says would show it, by its parameters."""
    out: dict[str, str] = {}
    for effect in model.effects:
        if effect.remedy and not effect.needs <= TRIED:
            sentence = f"{effect.remedy[0].upper()}{effect.remedy[1:]}."
            out |= {p.name: sentence for p in effect.parameters(model.robot)}
    return out


def _remedies(fit: Fit, options: IdentifyOptions) -> Iterator[tuple[str, Floats]]:
    """Remedies, the easiest first, and the information (F, F) that there would be with what each adds to the rows."""
    own = _information(fit.problem, fit.values)
    drawn = _drawn(fit)
    spread = own + _information(_simulated_problem(fit, drawn, options, turned=False), fit.values)
    yield SPREAD, spread
    if not fit.problem.measurement.observes_orientation:
        here = fit.problem.measurement.observations
        yield TURNED, own + _information(_simulated_problem(fit, here, options, turned=True), fit.values)
        yield BOTH, spread + _information(_simulated_problem(fit, drawn, options, turned=True), fit.values)
    yield from _conditions(fit, options, own)
    yield MORE, TENFOLD * own


def _conditions(fit: Fit, options: IdentifyOptions, own: Floats) -> Iterator[tuple[str, Floats]]:
    """The same poses under other conditions: where an effect reads them."""
    rows = fit.problem.measurement.observations
    needs = fit.problem.model.needs
    if "moments" in needs:
        heavier = (np.zeros(len(rows)) if rows.payload_kg is None else rows.payload_kg) + SECOND_KG
        loaded = _simulated_problem(fit, replace(rows, payload_kg=heavier), options, turned=False)
        yield LOADED, own + _information(loaded, fit.values)
    if "direction" in needs:
        both = np.random.default_rng(0).choice([-1.0, 1.0], rows.q.shape)
        sides = _simulated_problem(fit, replace(rows, direction=both), options, turned=False)
        yield SIDES, own + _information(sides, fit.values)


def _information(problem: Problem, values: Floats) -> Floats:
    """Information (F, F) of the rows of a problem, per prior sigma."""
    scaled = problem.linearise(values).J * problem.prior_sigma
    return np.asarray(scaled.T @ scaled)


def _identifiable_mask(information: Floats) -> Bools:
    """Whether each parameter (F,) would be known; the prior is one sigma of each."""
    posterior = np.linalg.inv(information + np.eye(len(information)))
    return identifiable(np.sqrt(np.diag(posterior)), np.ones(len(posterior)))


def _drawn(fit: Fit) -> Observations:
    """Poses all over the joint limits, under the conditions of the rows; the same every time."""
    rows, robot = fit.problem.measurement.observations, fit.problem.model.robot
    rng = np.random.default_rng(0)
    count = int(np.clip(int(rows.pose_groups().max()) + 1, FEWEST_DRAWN, MOST_DRAWN))
    low, high = within_a_turn(robot, rows.q)
    chosen = rows.select(rng.integers(0, len(rows), count))
    return replace(chosen, q=rng.uniform(low, high, (count, len(low))), pose_id=None, **MEASURED)


def _simulated_problem(fit: Fit, rows: Observations, options: IdentifyOptions, *, turned: bool) -> Problem:
    """The problem with other rows, whose tool a tracker would see where the model puts it."""
    problem = fit.problem
    calibration = Calibration(problem.model, fit.values)
    bare = replace(rows, **MEASURED)
    predicted = calibration.predict(bare)
    turns = turned or problem.measurement.observes_orientation
    shown = replace(bare, position=predicted.position, rotation=predicted.rotation if turns else None)
    measurement = measurement_for(shown, options) if options.base == "removed" else Measurement.from_observations(shown)
    weights = Weights(_common(problem.weights.points), START_SIGMA_RAD)
    return Problem(problem.model, measurement, problem.free, weights)


def _common(points: float | Floats) -> float:
    return float(np.sqrt(np.mean(np.square(points))))
