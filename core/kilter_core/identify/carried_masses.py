"""Masses that are never quite as stated: their errors are carried, with their priors, beside the effects that follow loads.

Beside an effect that follows the sign of a load, masses cannot be carried as parameters without many fits, since no slope
tells where a sign changes. They can be drawn: masses and centres as their standard deviations allow, each draw with the
loads and signs that it has, and the step that the fit would take from there, by the slopes that it has there: an amplitude
that wrong signs have put near zero is seen by the right ones only. The values stay as they are, and no fit is taken again:
errors of the masses are considered in the covariance, not estimated (Schmidt).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.arm.load_slopes import EACH, links_with_mass
from kilter_core.arm.robot import Robot
from kilter_core.effects import Effect
from kilter_core.effects.masses import LoadError
from kilter_core.identify.fit.least_squares import Fit, Problem
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.registry import METHODS
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import metres, mm
from kilter_core.types import Bools, Floats

DRAWS = 60  # of masses and centres


def with_masses(
    effects: tuple[Effect, ...], robot: Robot, rows: Observations, options: IdentifyOptions
) -> tuple[Effect, ...]:
    """The effects with the errors of the loads behind them, where one follows the load and none says it already.

    Methods that end at no least-squares minimum know no priors, so nothing could be carried there, nor beside effects that
    are held (``tilt_first``). Beside signs of a load it takes many fits, not all of which end: there it is asked for, and
    else what they do is considered (:func:`considered_masses`).
    """
    able = METHODS[options.method].minimum and not options.tilt_first
    if not able or not follow_loads(effects) or not _uncertain(effects, robot, options):
        return effects
    if any(e.nuisance for e in effects):
        return tuple(_as_known(e, options) if isinstance(e, LoadError) else e for e in effects)
    carried = _as_known(LoadError().configure_for_robot(robot, rows), options)
    return (*effects, carried) if carried.parameters(robot) else effects


def considered_masses(
    effects: tuple[Effect, ...], robot: Robot, rows: Observations, options: IdentifyOptions
) -> LoadError | None:
    """Errors of masses and centres that no parameter carries but that the sigmas are to hold; None where there are none."""
    able = METHODS[options.method].minimum and not options.tilt_first and options.masses == "auto"
    if not able or not _with_signs(effects) or any(e.nuisance for e in effects):
        return None
    errors = _as_known(LoadError().configure_for_robot(robot, rows), options)
    return errors if errors.parameters(robot) else None


def _uncertain(effects: tuple[Effect, ...], robot: Robot, options: IdentifyOptions) -> bool:
    """Whether masses count as uncertain: as asked, else where no effect has a sign of the load, and where torques tell them."""
    told = robot.told_loads is not None or not _with_signs(effects)
    return options.masses == "uncertain" or (options.masses == "auto" and told)


def _with_signs(effects: tuple[Effect, ...]) -> list[str]:
    """Ids of the effects that follow the sign of a load."""
    return list(dict.fromkeys(e.id for e in effects if hasattr(e, "softening_nm")))


def follow_loads(effects: tuple[Effect, ...]) -> list[str]:
    """Ids of the effects that read loads."""
    return list(dict.fromkeys(e.id for e in effects if "moments" in e.needs and not e.changes_loads))


def of_masses(model: RobotModel) -> Bools:
    """Which of the model's parameters (P,) are errors of masses and centres."""
    out = np.zeros(len(model.names), dtype=bool)
    for effect, where in zip(model.effects, model.effect_slices().values(), strict=True):
        out[where] = effect.nuisance
    return out


def beside_masses(fit: Fit) -> tuple[Floats, tuple[str, ...], Floats]:
    """Whitened Jacobian (R, K), names and prior sigmas (K,) of what is fitted beside the masses; of them where that is all.

    Masses are known as well as they were stated: that poses do not see them is not the poses' fault.
    """
    kept = ~of_masses(fit.problem.model)[fit.problem.free]
    kept |= not kept.any()
    names = tuple(name for name, own in zip(fit.names, kept, strict=True) if own)
    return fit.J[:, kept], names, fit.problem.prior_sigma[kept]


def describe_masses(
    robot: Robot, effects: tuple[Effect, ...], options: IdentifyOptions, considered: LoadError | None = None
) -> dict[str, Any] | None:
    """How masses were taken beside the effects of the model, with a sentence; None where no effect follows the load."""
    following = ", ".join(follow_loads(effects))
    if not following:
        return None
    carried = next((e for e in effects if isinstance(e, LoadError)), None)
    if carried is not None and robot.told_loads is not None:
        text = (
            f"Masses and centres beside {following} are those that torques showed: {_widths(carried, robot)} (standard "
            "deviations; load_model lists them, and how they hang together is counted)."
        )
    elif carried is not None:
        text = (
            f"Masses and centres count as uncertain beside {following}: {_widths(carried, robot)} (standard deviations; "
            "load_model lists them). mass_sigma_percent and com_sigma_mm, or the robot (payload_sigma of payloads), say how "
            'well they are known; masses "as_stated" takes them as exact.'
        )
    elif not METHODS[options.method].minimum:
        text = (
            f"Method {options.method} knows no priors: masses count as exact, so {following} may be off as far as they are "
            "wrong. Take method least_squares."
        )
    elif options.tilt_first:
        text = f"With tilt_first {following} are held, so nothing is said of the masses: they count as exact."
    elif options.masses == "as_stated":
        text = f"Masses and centres count as exact, as asked: the sigmas of {following} leave out what errors of the masses do."
    elif considered is not None:
        text = (
            f"Masses and centres count as stated beside {', '.join(_with_signs(effects))}, which follow the sign of a load. "
            f"The sigmas hold what errors do to them {_widths(considered, robot)}: mass_sigma_percent and com_sigma_mm, or "
            'the robot (payload_sigma of payloads), say how well they are known; masses "as_stated" takes them as exact, '
            '"uncertain" fits them, in many fits.'
        )
    else:
        text = (
            f"No link has a mass and no row a payload: {following} follow no load but those that rows state for links."
        )
    return {"carried": carried is not None, "considered": considered is not None, "sentence": text}


def _widths(effect: LoadError, robot: Robot) -> str:
    """Standard deviations of the masses of links, in percent of each, and of centres, and those of the payload."""
    found = effect.parameters(robot)
    links = [robot.links[k].mass for k in links_with_mass(robot)]
    of_links, of_payload = found[: EACH * len(links)], found[EACH * len(links) :]
    shares = [100.0 * p.prior_sigma / m for p, m in zip(of_links[::EACH], links, strict=True)]
    # A first moment is mass times centre; of the payload the place itself is known.
    places = [mm(p.prior_sigma / m) for p, m in zip(of_links[1::EACH], links, strict=True)]
    said = []
    if links:
        said.append(
            f"by {_span(shares, '%')} of each link's mass and {_span(places, 'mm')} of each coordinate of its centre"
        )
    if of_payload:
        share, place = 100.0 * of_payload[0].prior_sigma / effect.payload_kg, mm(of_payload[1].prior_sigma)
        said.append(f"by {share:.3g} % of the payload's mass and {place:.3g} mm of its place")
    return " and ".join(said)


def _span(values: list[float], unit: str) -> str:
    low, high = min(values), max(values)
    return f"{high:.3g} {unit}" if high - low < 1e-6 * high else f"{low:.3g} to {high:.3g} {unit}"


def _as_known(effect: LoadError, options: IdentifyOptions) -> LoadError:
    """The errors with the widths that were asked for."""
    share, centre = options.mass_sigma_percent, options.com_sigma_mm
    return replace(
        effect,
        mass_share=effect.mass_share if share is None else share / 100.0,
        centre_m=effect.centre_m if centre is None else metres(centre),
    )


def beside_drawn_masses(plain: Fit, fit: Fit, errors: LoadError) -> Fit:
    """The ``fit`` with what errors of masses and centres as wide as ``errors`` states add to its covariance.

    ``plain`` is the same fit as it ended. Predictions need none of it: loads that are off act on them as they did on the
    rows, and what that left is known.
    """
    before = plain.problem.wholly()
    model = replace(before.model, effects=(*before.model.effects, errors))
    moving = before.free >= model.n_geometric  # what loads act through; the chain's own columns hardly follow them
    problem = Problem(model, before.measurement, before.free[moving], before.weights, before.loss, whole=True)
    if len(plain.J) > sum(block.r.size for block in plain.residual.blocks):
        return fit  # a filter goes on from what it knew
    parameters = errors.parameters(model.robot)
    rng = np.random.default_rng(0)
    half = rng.standard_normal((DRAWS // 2, len(parameters))) * [p.prior_sigma for p in parameters]
    drawn = np.clip(np.vstack([half, -half]), [p.lower for p in parameters], [p.upper for p in parameters])
    J, steps = before.linearise(plain.values, plain.residual).J.copy(), []
    for one in drawn:
        here = problem.linearise(np.concatenate([plain.values, one]))
        J[:, moving] = here.J
        steps.append(np.linalg.solve(*before.derivatives(plain.values, replace(here, J=J))))
    moved = np.array(steps) * before.prior_sigma
    return replace(fit, covariance=fit.covariance + moved.T @ moved / len(drawn))
