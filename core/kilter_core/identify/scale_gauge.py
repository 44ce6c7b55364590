"""What the scale of a fit hangs on: the length of a ball bar, or the size of printed boards.

A board, the distances to the cameras and all lengths of the arm grow by one factor, and no pixel changes. So the factor is
that at which the board's stated scale and the nominal lengths, which a maker holds to half a millimetre, contradict each
other the least.

The nominal arm only raises the question, because an arm that is to be calibrated is wrong by more than many bars are. What
answers it is the fit: with the length as read and with the length that the joints command, whose deviations are then left
by noise alone, and whose parameters are those of an arm.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from kilter_core.errors import FindingDocument
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.plausibility.unrelated_views import scale_sentence
from kilter_core.identify.views import Cameras, rig_from_calibration, unknown_rig
from kilter_core.model import Calibration
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations import Observations
from kilter_core.transforms import inverse
from kilter_core.types import QUANTILE, Floats

MACHINED_M = 5e-4  # standard deviation of a length as its maker holds it
CHANCE = 1e-3  # of saying of a board that is as large as stated that it is not
ROUNDS = 50


def free_scale(fit: Fit) -> bool:
    """Whether everything may grow together: pixels and no measured length, boards of free scale, all lengths free.

    A prismatic joint tells the scale too.
    """
    rig = unknown_rig(fit.problem.model)
    return rig is not None and all(board.scale_sigma > 0.0 for board in rig.rig.boards) and _lengths_follow(fit)


def _lengths_follow(fit: Fit) -> bool:
    """Whether the arm's lengths follow the boards' scale alone: pixels, no measured length, all lengths free."""
    problem = fit.problem
    if problem.measurement.tells_scale:
        return False
    robot, names = problem.model.robot, set(fit.names)
    lengths = [e for e in robot.chain.elements if not e.axis.rotates]
    fixed = any(e.value != 0.0 and e.name not in names for e in lengths if e.joint is None)
    return not fixed and not any(joint.kind == "prismatic" for joint in robot.joints)


def contradicted_scale(fit: Fit) -> Iterator[FindingDocument]:
    """The warning ``board_scale_differs``: boards as large as stated, and lengths as described, cannot both be."""
    rig = rig_from_calibration(fit.calibration())
    if rig is None or not rig.boards or not _lengths_follow(fit):
        return
    scale = 1.0 + float(np.mean([place.values[0] for place in rig.boards]))
    shorter, sigma = _shrunk(fit, scale)
    stated = min(board.scale_sigma for board in rig.rig.boards)
    sigma = float(np.hypot(sigma, stated))
    if 2.0 * float(ndtr(-abs(shorter) / sigma)) > CHANCE:
        return
    names = " and ".join(board.name for board in rig.rig.boards)
    size, half = 1e2 * (1.0 / (1.0 + shorter) - 1.0), 1e2 * QUANTILE * sigma
    yield FindingDocument.make(
        "board_scale_differs",
        scale_sentence(names, size, half) + " This version has a robot of another size: do not correct with it.",
        boards=[board.name for board in rig.rig.boards],
        larger_percent=size,
        u95_percent=half,
    )


def _shrunk(fit: Fit, scale: float) -> tuple[float, float]:
    """By what share all lengths of the arm are longer than described, with the boards as large as stated, and its deviation.

    Lengths differ from described ones by that and by what a maker leaves, or by as much as these views show.
    """
    model = fit.problem.model
    names = [str(e.name) for e in model.robot.chain.elements if e.name in fit.names and not e.axis.rotates]
    own = [fit.names.index(name) for name in names]
    nominal = np.array([model.parameter(name).value for name in names])
    away = fit.values[[model.names.index(name) for name in names]] / scale - nominal
    of_scale = [k for k, name in enumerate(fit.names) if name.startswith("board_") and name.endswith("_scale")]
    T = np.zeros((len(own), len(fit.names)))
    T[np.arange(len(own)), own] = 1.0 / scale
    T[:, of_scale] = -(nominal + away)[:, None] / scale / max(len(of_scale), 1)
    known = np.linalg.inv(T @ fit.covariance @ T.T)
    told = known - np.linalg.inv((T * fit.problem.prior_sigma**2) @ T.T)
    w, V = np.linalg.eigh(0.5 * (told + told.T))
    told = (V * np.maximum(w, 0.0)) @ V.T
    pull, variance = known @ away, MACHINED_M**2
    for _ in range(ROUNDS):
        K = np.linalg.inv(told + np.eye(len(own)) / variance)
        precision = float(nominal @ (K @ told) @ nominal) / variance
        by = float(nominal @ K @ pull) / variance / max(precision, 1e-300)
        left = K @ (pull + by * nominal / variance) - by * nominal
        variance = max(MACHINED_M**2, float(np.mean(left**2 + np.diag(K))))
    return by, precision**-0.5 if precision > 0.0 else np.inf


def with_likeliest_scale(fit: Fit) -> Fit:
    """The fit grown by the likeliest factor; as it is where the factor is known or nothing may grow."""
    if not free_scale(fit):
        return fit
    problem = fit.problem
    model, values = problem.model, fit.values
    rig = rig_from_calibration(fit.calibration())
    assert rig is not None
    lengths = [e.name for e in model.robot.chain.elements if e.name in fit.names and not e.axis.rotates]
    places = [model.names.index(str(name)) for name in lengths]
    nominal = np.array([model.parameters[k].value for k in places])
    found = values[places]
    scales = np.array([place.values[0] for place in rig.boards])
    sigmas = np.array([board.scale_sigma for board in rig.rig.boards])
    # (1 + t) times each: stated scales and nominal lengths pull at t.
    pull = np.sum((1.0 + scales) * -scales / sigmas**2) + np.sum(found * (nominal - found)) / MACHINED_M**2
    stiff = np.sum(((1.0 + scales) / sigmas) ** 2) + np.sum(found**2) / MACHINED_M**2
    grown = 1.0 + float(pull / stiff)
    out = values.copy()
    out[places] *= grown
    effect = Cameras(rig=_grown(rig, grown, model.T_base, model.T_tool))
    effects = tuple(effect if isinstance(e, Cameras) else e for e in model.effects)
    at = next(where for e, where in model.effects_with_slices if isinstance(e, Cameras))
    assert effect.rig is not None
    out[at] = effect.rig.values
    return replace(fit, problem=replace(problem, model=replace(model, effects=effects)), values=out)


def _grown(rig: PlacedRig, by: float, T_base: Floats, T_tool: Floats) -> PlacedRig:
    """The rig with all distances from base and flange, and the boards themselves, ``by`` times as large."""
    seen = rig.transform_frames(base=inverse(T_base), tool=T_tool).with_folded_increments()
    for place in (*seen.cameras, *seen.boards):
        place.origin[:3, 3] *= by
    boards = tuple(replace(b, values=(1.0 + b.values) * by - 1.0) for b in seen.boards)
    return replace(seen, boards=boards).transform_frames(base=T_base, tool=inverse(T_tool)).with_folded_increments()


SHARE, LEAST_M = 0.01, 1e-3  # robots are truer than one part in a hundred
FEWEST_LENGTHS = 8  # readings of a bar
MARGIN = 6.0  # 2 log of a Bayes factor of 20, in favour of another length than was read
LARGEST_M = 1e-2  # left by a fit that says nothing of its rows: arms err by millimetres before they are calibrated
SMALLEST_M = 1e-7  # no bar and no arm leaves less
FLAT = 1e-3  # of the spread across a plane: the bar went round in it


def other_lengths(arm: Calibration, rows: Observations) -> list[tuple[int, float, float]]:
    """Bars (number, length read, length by the joints of ``arm``; m) for which the two differ by more than robots err."""
    if rows.bar is None or rows.bar_length is None:
        return []
    p = arm.predict(rows).position
    out = []
    for number in np.unique(rows.bar[rows.bar > 0]):
        mine = rows.bar == number
        read = float(np.mean(rows.bar_length[mine]))
        found = _radius(p[mine])
        if found is not None and abs(found - read) > max(SHARE * read, LEAST_M):
            out.append((int(number), read, found))
    return out


def scale_bar_readings(rows: Observations, bar: int, factor: float) -> Observations:
    """Rows whose readings of one bar are multiplied by a factor."""
    assert rows.bar is not None
    assert rows.bar_length is not None
    return replace(rows, bar_length=np.where(rows.bar == bar, factor, 1.0) * rows.bar_length)


def explains_better(other: Fit, fit: Fit) -> bool:
    """Whether a fit with another length says the same rows better, with parameters as plausible: by likelihood and priors.

    Of two fits of which neither comes near the rows, as of one circle that tells an arm too little, none says a length.
    """
    return _residual_rms(other) < LARGEST_M and _badness(other) < _badness(fit) - MARGIN


def _badness(fit: Fit) -> float:
    """Twice the negative log of likelihood, of noise of unknown size, times that of the priors."""
    left = fit.residual.points[np.isfinite(fit.residual.points)]
    problem, rows = fit.problem, len(fit.residual.points)
    moved = (fit.values[problem.free] - problem.prior_mean) / problem.prior_sigma
    return rows * float(np.log(max(float(left @ left) / rows, SMALLEST_M**2))) + float(moved @ moved)


def _residual_rms(fit: Fit) -> float:
    """What a fit leaves of its rows, rms, m."""
    left = fit.residual.points[np.isfinite(fit.residual.points)]
    return float(np.sqrt(np.mean(left**2))) if len(left) else np.inf


def _radius(p: Floats) -> float | None:
    """Radius of the sphere through the points, of the circle where they lie in a plane; None of too few or a short arc."""
    if len(p) < FEWEST_LENGTHS:
        return None
    middle = p.mean(axis=0)
    sizes, axes = np.linalg.svd(p - middle, full_matrices=False)[1:]
    kept = 2 if sizes[2] < FLAT * sizes[0] else 3
    local = (p - middle) @ axes[:kept].T
    solved = np.linalg.lstsq(np.column_stack([2 * local, np.ones(len(p))]), (local**2).sum(axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(solved[-1] + float(solved[:-1] @ solved[:-1]), 0.0)))
    # A short arc tells no radius.
    return radius if sizes[1] / np.sqrt(len(p)) > 0.2 * radius else None
