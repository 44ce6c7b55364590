"""What an arm carries, from torques with it and without it: mass, centre and inertia, and how sure they are.

Both logs share bodies and friction, and the ten numbers of what is carried are fitted with them (Gaz and De Luca 2017).
Friction that grows with the load belongs to the model: without it the load would be blamed for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import ObservationError
from kilter_core.motion.effects import CARRIED_WITH
from kilter_core.motion.fit import covariance, fit_terms, joint_weights
from kilter_core.motion.layout import Known, Layout
from kilter_core.motion.normal import Equations, form_equations
from kilter_core.motion.record import Log
from kilter_core.motion.regressor import describe_body, symmetric, tool_in_link
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats

EMPTY, LOADED = 0, 1
FEWEST_SIGMAS = 3.0  # by which a mass must be above zero before it has a centre
STEP = 1e-6


@dataclass(frozen=True)
class CarriedBody:
    """``mass`` kg, ``centre (3,)`` m in the tool frame and ``inertia (3, 3)`` kg m² about it in its axes, with standard
    deviations; the centre and the inertia are NaN where the mass is not above its own uncertainty.

    ``left (2, n)`` N m are what the model of the empty arm leaves of the torques with the load, and what the fit leaves.
    """

    mass: float
    mass_sigma: float
    centre: Floats
    centre_sigma: Floats
    inertia: Floats
    inertia_sigma: Floats
    left: Floats


def weigh_payload(robot: Robot, loaded: Sequence[Observations], empty: Sequence[Observations]) -> CarriedBody:
    """Return what is carried in the logs ``loaded`` and not in those that are ``empty``.

    Raises:
        ObservationError: logs without clock or torques, or no joint that moves in both. TooFewPosesError: no motion of 2 s.

    """
    rows = Observations.concatenate([*_as_session(empty, EMPTY), *_as_session(loaded, LOADED)])
    log = Log.from_observations(rows)
    layout = Layout.of_log(robot, log, LOADED)
    first = form_equations(layout, log)
    with_load = first.session == LOADED
    _refuse_one_sided(first, with_load)
    every = np.ones(len(with_load), dtype=bool)
    weights = joint_weights(first, first.terms, every)
    known = Known.from_values(layout, fit_terms(first, first.terms, every, weights).theta)
    equations = form_equations(layout.with_candidates((None,) * robot.n_joints), log, known)
    terms = [t for t in equations.terms if t.effect.common or t.effect.id in CARRIED_WITH]
    fit = fit_terms(equations, terms, every, weights)
    at = next(term.columns for term in terms if term.session == LOADED)
    numbers, spread = fit.theta[at], covariance(equations, fit, every)[np.ix_(at, at)]
    without = fit.theta.copy()
    without[at] = 0.0
    left = np.stack([equations.rms(theta, with_load) for theta in (without, fit.theta)])
    return describe_carried(tool_in_link(robot), numbers, spread, left)


def _as_session(parts: Sequence[Observations], session: int) -> list[Observations]:
    """Rows without what differs between campaigns and torques do not need."""
    return [Observations(q=one.q, t=one.t, tau=one.tau, session=np.full(len(one), session)) for one in parts]


def _refuse_one_sided(equations: Equations, with_load: Bools) -> None:
    moved = [(equations.rows[side] > 0).any() for side in (with_load, ~with_load)]
    if not all(moved):
        which = "with the load" if not moved[0] else "without it"
        raise ObservationError(
            f"No joint moves in the log {which}: record the same motions with and without the load.", code="log_at_rest"
        )


def describe_carried(tool: Floats, numbers: Floats, spread: Floats, left: Floats) -> CarriedBody:
    """Return the body of these numbers (10,) and their covariance in a frame in which the tool is at ``tool (4, 4)``."""
    told = _describe(numbers, tool)
    slopes = np.stack([(_describe(numbers + d, tool) - told) / STEP for d in STEP * np.eye(len(numbers))], axis=1)
    sigma = np.sqrt(np.maximum(np.diag(slopes @ spread @ slopes.T), 0.0))
    if told[0] < FEWEST_SIGMAS * sigma[0]:
        told[1:], sigma[1:] = np.nan, np.nan
    return CarriedBody(
        float(told[0]), float(sigma[0]), told[1:4], sigma[1:4], symmetric(told[4:]), symmetric(sigma[4:]), left
    )


def _describe(numbers: Floats, tool: Floats) -> Floats:
    """Mass, centre (3,) and inertia (6,) about it in the frame ``tool (4, 4)`` of numbers in the body's frame."""
    mass, centre, about_centre = describe_body(numbers)
    R = tool[:3, :3]
    inertia = R.T @ about_centre @ R
    return np.array([mass, *(R.T @ (centre - tool[:3, 3])), *inertia[np.triu_indices(3)]])
