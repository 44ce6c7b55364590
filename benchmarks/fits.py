"""Large fits: Levenberg and Marquardt with 60 parameters, a thousand bootstrap refits, and how the cost grows."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.table import Line, best_of
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects import make_effect
from kilter_core.identify import IdentifyOptions
from kilter_core.identify.estimate import estimate, prepare_problem
from kilter_core.identify.fit.least_squares import solve
from kilter_core.identify.uncertainty.stated_noise import RESAMPLES, bootstrap
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.plan.d_optimal import iso_poses
from kilter_core.twin import thesis_katana

Floats = NDArray[np.float64]

EFFECTS = ("clearance_tilt", "backlash_load", "axial_compliance", "radial_compliance", "base_compliance")
MASS_KG = (7.0, 13.0, 4.0, 2.0, 2.0, 0.4)
NOISE_M = 2e-5
SIZES = (100, 1_000, 10_000, 100_000)
MOST_MS, MOST_BOOTSTRAP_S, MOST_POWER = 100.0, 30.0, 1.1


def arm() -> RobotModel:
    """A UR10 with link masses, in which everything that carries load gives way."""
    links = [{"mass_kg": kg, "com_mm": [-100.0 if k in (1, 2) else 0.0, 0.0, 30.0]} for k, kg in enumerate(MASS_KG)]
    robot = robot_from_document({**preset_document("ur10"), "links": links})
    return RobotModel(robot, tuple(make_effect(e).configure_for_robot(robot) for e in EFFECTS))


def campaign(model: RobotModel, count: int, seed: int = 0) -> Observations:
    """Positions of an arm with an error in every parameter."""
    rng = np.random.default_rng(seed)
    sigma = np.array([p.prior_sigma for p in model.parameters])
    error = 0.1 * sigma * rng.normal(size=len(sigma))
    values = model.values0() + np.where([p.lower >= 0.0 for p in model.parameters], np.abs(error), error)
    q = rng.uniform(-2.5, 2.5, (count, 6))
    exact = model.predict(Observations(q), values).position
    return Observations(q, position=exact + rng.normal(0.0, NOISE_M, exact.shape))


def lines() -> list[Line]:
    """The figures of the section on speed."""
    return [*_large_fit(), _bootstrap(), *_growth()]


def _large_fit() -> list[Line]:
    model = arm()
    start, options = Calibration(model, model.values0()), IdentifyOptions(level=3, noise_mm=NOISE_M * 1e3)
    rows = Measurement.from_observations(campaign(model, 1_000))
    problem, values = prepare_problem(start, rows, options)
    fit = solve(problem, values)
    alone = best_of(lambda: solve(problem, values), 10) * 1e3
    whole = best_of(lambda: estimate(start, rows, IdentifyOptions(level=3)), 5) * 1e3
    what = f"1000 poses, {len(fit.names)} parameters"
    return [
        Line(f"Levenberg-Marquardt, {what}", f"{alone:.0f} ms", f"<= {MOST_MS:.0f} ms", alone <= MOST_MS),
        Line("  the same with registration, and noise and blind directions found", f"{whole:.0f} ms"),
    ]


def _bootstrap() -> Line:
    twin = thesis_katana()
    rows = twin.observe(iso_poses(twin.robot, 118), noise_m=1e-5)
    options = IdentifyOptions(level=3)
    start = Calibration.nominal(twin.robot, tuple(e.configure_for_robot(twin.robot) for e in options.make_effects()))
    fit = estimate(start, Measurement.from_observations(rows), options)
    seconds = best_of(lambda: bootstrap(fit, 0, lambda fraction, stage: None), 3)
    what = f"{RESAMPLES} bootstrap refits of the Katana, 118 poses, {len(fit.names)} parameters"
    return Line(what, f"{seconds:.2f} s", f"<= {MOST_BOOTSTRAP_S:.0f} s", seconds <= MOST_BOOTSTRAP_S)


def _growth() -> list[Line]:
    """Time of one fit per pose and iteration, from a hundred poses to a hundred thousand."""
    robot = robot_from_document(preset_document("ur10"))
    model = RobotModel(robot)
    each, out = {}, []
    for count in SIZES:
        start = Calibration(model, model.values0())
        problem, values = prepare_problem(
            start, Measurement.from_observations(campaign(model, count)), IdentifyOptions(noise_mm=0.02)
        )
        shortest, iterations = float("inf"), 1
        for _ in range(max(2, 20_000 // count)):
            began = time.perf_counter()
            iterations = solve(problem, values).iterations
            shortest = min(shortest, time.perf_counter() - began)
        each[count] = shortest / count / iterations
        per = f"{1e6 * each[count]:.1f} us per pose and iteration"
        out.append(Line(f"fit of {count} poses, {len(problem.free)} parameters", f"{shortest * 1e3:.0f} ms, {per}"))
    whole = np.array([each[count] * count for count in SIZES])
    power = float(np.polyfit(np.log(SIZES), np.log(whole), 1)[0])
    most = f"<= {MOST_POWER}"
    out.append(Line("  cost grows with the poses to the power of", f"{power:.2f}", most, power <= MOST_POWER))
    out.append(Line("  a pose of 100 000 costs against one of 1000", f"{each[SIZES[-1]] / each[SIZES[1]]:.2f} x"))
    return out
