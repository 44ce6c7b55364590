"""Masses, centres and inertias of links that could be real, and make the torques that a log shows.

Torques show sums of the numbers of links, the base parameters. Of all links with these sums the ones nearest to the
description are taken, each with a positive definite pseudo-inertia (Wensing, Kim and Slotine 2018). Near is by the divergence
of Lee and Park (2018), so that what is sought is convex and has one answer.
"""

from __future__ import annotations

import numpy as np

from kilter_core.arm.robot import Link, Robot
from kilter_core.motion.regressor import PER_LINK, base_sums, describe_body, link_elements, stated_numbers, symmetric
from kilter_core.types import Floats

NEAR = 0.25  # weight of the divergence against squares of standard deviations
LEAST_KG = 1e-2  # of a link that the description leaves without a mass
LEAST_GYRATION_M = 0.02
STEPS = 50
WEIGHTS = 12
SUFFICIENT = 0.1  # of the fall that the slope promises
DONE = 1e-9  # promised fall of the cost
UPPER = np.triu_indices(3)


def physical_links(robot: Robot, base: Floats, information: Floats) -> tuple[Link, ...]:
    """Return links with the ``base (p,)`` parameters, as far as links that could be real have them.

    ``information (p, p)`` is the inverse of their covariance; it says which sums may differ from the fit.
    """
    K = base_sums(robot)
    start = np.stack([_make_definite(numbers) for numbers in stated_numbers(robot).reshape(-1, PER_LINK)])
    found = _find_nearest(start, K.T @ information @ K, K.T @ information @ base)
    return tuple(
        Link(element, *describe_body(numbers)) for element, numbers in zip(link_elements(robot), found, strict=True)
    )


def _find_nearest(start: Floats, A: Floats, b: Floats) -> Floats:
    """Numbers (L, 10) that make the least of ``x A x / 2 - b x`` and of their divergence from ``start``.

    Newton's steps, from a weight of the divergence at which it decides down to the one it has.
    """
    x = start.ravel()
    weights = np.geomspace(max(np.abs(A @ x - b).max() * np.abs(x).max(), NEAR), NEAR, WEIGHTS)
    for weight in weights:
        x = _follow_slope(x, start, A / weight, b / weight)
    return x.reshape(-1, PER_LINK)


def _follow_slope(x: Floats, start: Floats, A: Floats, b: Floats) -> Floats:
    """Newton's steps from ``x (10 L,)``, with a divergence of weight one."""
    pull = np.einsum("lab,iba->li", np.linalg.inv(_pseudo_inertia(start)), BASIS).ravel() - b

    def cost(x: Floats) -> float:
        J = _pseudo_inertia(x.reshape(-1, PER_LINK))
        if np.linalg.eigvalsh(J).min() <= 0.0:
            return np.inf
        return float(0.5 * x @ A @ x + pull @ x - np.linalg.slogdet(J)[1].sum())

    for _ in range(STEPS):
        inverse = np.linalg.inv(_pseudo_inertia(x.reshape(-1, PER_LINK)))
        slopes = inverse[:, None] @ BASIS  # (L, 10, 4, 4)
        gradient = A @ x + pull - np.einsum("liaa->li", slopes).ravel()
        H = A.copy()
        for k, own in enumerate(np.einsum("liab,ljba->lij", slopes, slopes)):
            at = slice(PER_LINK * k, PER_LINK * (k + 1))
            H[at, at] += own
        scale = 1.0 / np.sqrt(np.diag(H))
        step = -scale * np.linalg.solve(scale[:, None] * H * scale, scale * gradient)
        promised, share, here = float(-gradient @ step), 1.0, cost(x)
        while share > DONE and cost(x + share * step) > here - SUFFICIENT * share * promised:
            share *= 0.5
        x = x + share * step
        if promised < DONE:
            break
    return x


def _pseudo_inertia(numbers: Floats) -> Floats:
    """Second moments (L, 4, 4) of mass of links, of their places and one."""
    return np.asarray(np.einsum("li,iab->lab", numbers, BASIS))


def _basis() -> Floats:
    """The pseudo-inertia (10, 4, 4) of one unit of each number."""
    out = np.zeros((PER_LINK, 4, 4))
    for i, unit in enumerate(np.eye(PER_LINK)):
        inertia = symmetric(unit[4:])
        out[i, :3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        out[i, :3, 3] = out[i, 3, :3] = unit[1:4]
        out[i, 3, 3] = unit[0]
    return out


def _make_definite(numbers: Floats) -> Floats:
    """Return the numbers of a body that has some thickness; where none is stated, of a small one."""
    mass, moment = max(float(numbers[0]), LEAST_KG), numbers[1:4]
    spread = np.outer(moment, moment) / mass
    places = 0.5 * np.trace(symmetric(numbers[4:])) * np.eye(3) - symmetric(numbers[4:]) - spread
    values, axes = np.linalg.eigh(places)
    places = (axes * np.maximum(values, mass * LEAST_GYRATION_M**2)) @ axes.T + spread
    return np.array([mass, *moment, *(np.trace(places) * np.eye(3) - places)[UPPER]])


BASIS = _basis()
