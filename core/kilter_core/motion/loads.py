"""What torques say of the masses of links: for searches in poses, whose effects follow the static load.

Torques show sums of the numbers of links. Those that the sums leave open stay as described, and as uncertain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.arm.load_slopes import links_with_mass
from kilter_core.arm.robot import Robot
from kilter_core.effects.masses import LoadError
from kilter_core.errors import OptionError
from kilter_core.motion.fit import Fit, covariance
from kilter_core.motion.normal import Equations
from kilter_core.motion.regressor import PER_LINK, base_sums, stated_numbers
from kilter_core.parameters import CorrelatedPrior
from kilter_core.types import Bools, Floats

FIRST = 4  # numbers of a link that act at rest: its mass and first moment
GAIN_SHARE = 0.05  # of a torque: its sensor, or the constant of the motor behind a current
UNSTATED_KG = 1.0  # of a link that the description leaves without a mass
UNSTATED_M = 0.1
WIDTHS = np.geomspace(1.0, 10.0, 25)  # times standard deviations of the description
NEAR_REST = ("coulomb", "stribeck")  # friction that is left as a joint stops
GYRATION_M = 0.1  # of an inertia that is not as stated


def tell_loads(equations: Equations, fit: Fit, blocks: Bools) -> CorrelatedPrior | None:
    """Return what a fit of a log's ``blocks`` says of mass and first moment of each link that the description gives a mass,
    beyond what was stated; None where it gives none.

    The Gaussian of the description, conditioned on the base parameters, which scatter from second to second. An error of each
    joint's gain by :data:`GAIN_SHARE` is considered in the covariance, not estimated (Schmidt): masses would share it.
    """
    robot = replace(equations.layout.robot, told_loads=None)  # what an earlier log said would count twice
    own = [p for p in LoadError().parameters(robot) if p.name.startswith("link_")]
    if not own:
        return None
    p = equations.base
    C = (fit.inverse + covariance(equations, fit, blocks))[:p, :p]
    T, sigma = _changes(robot, np.array([one.prior_sigma for one in own]))
    K = base_sums(robot)
    A, apart = K @ T, fit.theta[:p] - K @ stated_numbers(robot)
    sigma = sigma * _widening(A * sigma, C, apart)
    scaled = A * sigma
    by_base = scaled.T @ np.linalg.inv(C)
    P = np.linalg.inv(np.eye(len(sigma)) + by_base @ scaled)
    by_gain = P @ by_base @ _slopes_by_gain(equations, fit, blocks)[:p]
    mean, spread = sigma * (P @ by_base @ apart), np.outer(sigma, sigma) * (P + GAIN_SHARE**2 * by_gain @ by_gain.T)
    at = _places_of_load_errors(robot)
    return CorrelatedPrior(tuple(one.name for one in own), mean[at], spread[np.ix_(at, at)])


def tell_friction(equations: Equations, fit: Fit, blocks: Bools) -> Floats:
    """Return the friction (n, 2) N m of each joint near rest and its standard deviation; NaN where it follows the load, so
    that it is no one number, or where the log says nothing.
    """
    C, out = fit.inverse + covariance(equations, fit, blocks), np.full((equations.layout.robot.n_joints, 2), np.nan)
    at = {int(column): n for n, column in enumerate(fit.columns)}
    for j in range(len(out)):
        own = {t.effect.id: t.columns for t in equations.layout.terms if t.joint == j and t.columns[0] in at}
        places = [at[int(own[name][0])] for name in NEAR_REST if name in own]
        value = float(fit.theta[fit.columns[places]].sum())
        if places and "load_friction" not in own:
            out[j] = value, np.hypot(np.sqrt(C[np.ix_(places, places)].sum()), GAIN_SHARE * value)
    return out


def loads_document(robot: Robot, loads: CorrelatedPrior | None) -> dict[str, Any] | None:
    """Return what :func:`told_loads` reads: ``mean`` and ``covariance`` (kg, kg m) beyond what the description ``stated``."""
    if loads is None:
        return None
    return {
        "names": list(loads.names),
        "stated": _stated_of_loads(robot).tolist(),
        "mean": loads.mean.tolist(),
        "covariance": loads.covariance.tolist(),
    }


def friction_document(friction: Floats | None) -> list[list[float | None]] | None:
    """Return what :func:`with_torques_told` reads of friction (n, 2); None where it is not known."""
    return None if friction is None else [[None if np.isnan(x) else x for x in row] for row in friction.tolist()]


def with_torques_told(robot: Robot, model: Mapping[str, Any]) -> Robot:
    """Return a robot that knows what the model of a search in torques says of its masses and its friction.

    Raises:
        OptionError: as of :func:`told_loads`.

    """
    friction = model.get("friction")
    told = None if friction is None else np.array(friction, dtype=np.float64)
    return replace(robot, told_loads=told_loads(robot, model.get("loads")), told_friction=told)


def told_loads(robot: Robot, document: Mapping[str, Any] | None) -> CorrelatedPrior:
    """Read what a search in torques says of the masses of a robot.

    Raises:
        OptionError: it says nothing of them, or the description states others by now.

    """
    if document is None:
        raise OptionError(
            "That search says nothing of masses, since the robot is described without any: state masses and centres "
            "(from a data sheet, roughly), search the log again, and name that search.",
            option="masses_from",
        )
    stated = _stated_of_loads(robot)
    if len(document["stated"]) != len(stated) or not np.allclose(document["stated"], stated, rtol=1e-9, atol=1e-12):
        raise OptionError(
            f"Masses or centres of robot {robot.name!r} are described otherwise since that search: search the log again, "
            "and name the new search.",
            option="masses_from",
        )
    return CorrelatedPrior(tuple(document["names"]), np.array(document["mean"]), np.array(document["covariance"]))


def _stated_of_loads(robot: Robot) -> Floats:
    """Mass and first moment, kg and kg m, of the links with a mass as described."""
    return stated_numbers(robot)[_places_of_load_errors(robot)]


def _widening(scaled: Floats, C: Floats, apart: Floats) -> float:
    """How many times as wrong as it says the description most likely is, where torques are ``apart (p,)`` from it."""

    def surprise(w: float) -> float:
        S = w**2 * scaled @ scaled.T + C
        return float(np.linalg.slogdet(S)[1] + apart @ np.linalg.solve(S, apart))

    return float(min(WIDTHS.tolist(), key=surprise))


def _slopes_by_gain(equations: Equations, fit: Fit, blocks: Bools) -> Floats:
    """Derivatives (k, n) of the values of a fit by the gain of each joint."""
    each = np.diag(fit.weights)
    return np.stack([fit.inverse @ equations.sum_blocks(blocks, one)[1][fit.columns] for one in each], axis=1)


def _changes(robot: Robot, of_loads: Floats) -> tuple[Floats, Floats]:
    """Numbers (10 L, 10 L) of all bodies by what may be wrong of them, and standard deviations (10 L,) of that.

    Mass at the stated centre, first moment beyond, inertia.
    """
    stated = stated_numbers(robot).reshape(-1, PER_LINK)
    T, sigma = np.eye(stated.size), np.empty(stated.shape)
    for k, numbers in enumerate(stated):
        mass = max(float(numbers[0]), 0.0)
        if mass > 0.0:
            at = PER_LINK * k
            T[at + 1 : at + FIRST, at] = numbers[1:FIRST] / mass
        wide = mass or UNSTATED_KG
        sigma[k, 0], sigma[k, 1:FIRST] = UNSTATED_KG, UNSTATED_KG * UNSTATED_M
        sigma[k, FIRST:] = 0.5 * np.abs(numbers[[4, 7, 9]]).max() + wide * GYRATION_M**2
    flat = sigma.reshape(-1)
    flat[_places_of_load_errors(robot)] = of_loads
    return T, flat


def _places_of_load_errors(robot: Robot) -> list[int]:
    """Where mass and first moment of the links with a mass are among the numbers of all bodies."""
    return [PER_LINK * k + i for k in links_with_mass(robot) for i in range(FIRST)]
