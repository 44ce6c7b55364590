"""What a version needs to be corrected over its workspace, and what a program promises of every correction.

A limit that is too small leaves errors that the version knows how to remove, one that is too large lets a wrong version
move the arm far. So the rows are corrected within the widest limits that :func:`needs` would ever suggest, and what
most of them need is the suggestion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectedRows, CorrectionOptions, CorrectionProgram, compile_program
from kilter_core.errors import ObservationError
from kilter_core.model import Calibration
from kilter_core.types import Floats

QUANTILES = (0.5, 0.9, 0.95, 0.99)
COVERED, MARGIN = 0.99, 1.25
LEAST_RAD, LEAST_M = math.radians(1.0), 0.005  # what every suggestion allows
MOST_RAD, MOST_M = (
    math.radians(5.0),
    0.025,
)  # and what none exceeds: beyond, the zero offsets belong into the controller


@dataclass(frozen=True)
class Needs:
    """What N poses need of a correction, and what becomes of them within limits.

    Within the widest limits: ``joints`` has the size of the correction (n,) rad or m by quantile, ``largest (n,)`` its
    maximum; ``removed`` the error of the tool m by quantile; ``turned`` what is left of
    its orientation rad by quantile.
    Within the limits of the options: shares of the rows that are refused, damped near a singular posture, held at a
    limit, and that keep more of the point's error than ``reached_m``; ``most_left`` m is the largest that is kept. The
    same ``within_suggested``. ``largest_rad``, ``largest_m``, ``farthest_m`` are the suggested limits: what 99 % of the
    poses need and a quarter more, at least 1 deg and 5 mm, at most 5 deg and 25 mm; ``capped`` where more is needed.
    ``rows`` are the poses within the limits of the options, one by one, for a map.
    """

    joints: Mapping[float, Floats]
    largest: Floats
    removed: Mapping[float, float]
    turned: Mapping[float, float]
    largest_rad: float
    largest_m: float
    farthest_m: float
    capped: bool
    within: Shares
    within_suggested: Shares
    rows: CorrectedRows


@dataclass(frozen=True)
class Shares:
    """Shares of poses that are refused, damped, held at a limit, or left with an error of the point; the largest m."""

    refused: float
    damped: float
    held: float
    left: float
    most_left: float


def needs(calibration: Calibration, q: Floats, options: CorrectionOptions | None = None) -> Needs:
    """What poses ``q (N, n)`` within the joint limits need to be corrected.

    Raises:
        ObservationError: no pose is given, or one is not finite.

    """
    options = options or CorrectionOptions()
    if not len(q) or not np.isfinite(q).all():
        raise ObservationError("What a version needs is told from poses: give at least one, all of finite numbers.")
    widest = replace(options, largest_rad=MOST_RAD, largest_m=MOST_M, farthest_m=MOST_M, at_limit="saturate")
    wide = compile_program(calibration, widest).correct_rows(q)
    size, far = np.abs(wide.q - q), np.linalg.norm(wide.error_removed, axis=1)
    revolute = np.array([joint.kind == "revolute" for joint in calibration.robot.joints])
    of_row = (size[:, kind].max(axis=1, initial=0.0) for kind in (revolute, ~revolute))
    asked = [MARGIN * float(np.quantile(what, COVERED)) for what in (*of_row, far)]
    bounds = ((LEAST_RAD, MOST_RAD), (LEAST_M, MOST_M), (LEAST_M, MOST_M))
    suggested = [min(max(least, need), most) for need, (least, most) in zip(asked, bounds, strict=True)]
    limits = dict(zip(("largest_rad", "largest_m", "farthest_m"), suggested, strict=True))
    rows = compile_program(calibration, options).correct_rows(q)
    within_suggested = compile_program(calibration, replace(options, **limits)).correct_rows(q)  # type: ignore[arg-type]
    return Needs(
        joints=MappingProxyType({level: np.quantile(size, level, axis=0) for level in QUANTILES}),
        largest=size.max(axis=0),
        removed=_quantiles(far),
        turned=_quantiles(wide.left_rad),
        **limits,
        capped=any(need > most for need, (_, most) in zip(asked, bounds, strict=True)),
        within=_shares(rows, options),
        within_suggested=_shares(within_suggested, options),
        rows=rows,
    )


def _quantiles(what: Floats) -> Mapping[float, float]:
    return MappingProxyType({level: float(np.quantile(what, level)) for level in QUANTILES})


def _shares(rows: CorrectedRows, options: CorrectionOptions) -> Shares:
    good = rows.status == layout.OK
    left = np.linalg.norm(rows.left, axis=1)
    return Shares(
        refused=float(np.mean(~good)),
        damped=float(np.mean(good & (rows.flags & layout.DAMPED != 0))),
        held=float(np.mean(good & (rows.flags & layout.SATURATED != 0))),
        left=float(np.mean(good & (left > options.reached_m))),
        most_left=float(left[good].max(initial=0.0)),
    )


PARALLEL = 1.0 - 1e-9


def levers(program: CorrectionProgram) -> Floats:
    """Most motion of the tool point (n,) per motion of each joint, m/rad or m/m, wherever the other joints are.

    For a revolute joint this is how far the tool can be from its axis: the links after it stretched out, those between
    parallel axes across these only. An upper bound, by the nominal arm; infinite behind a prismatic joint without limits.
    """
    m = program.moves
    moves, joints = program.array[: m + 1], program.array[m + 1 : m + 1 + program.n_joints]
    out = np.zeros(program.n_joints)
    for k in range(m):
        reach = 1.0 if moves[k, layout.KIND] else _farthest(moves[k + 1 :], joints)
        out[int(moves[k, layout.JOINT])] += abs(moves[k, layout.RATIO]) * reach
    return out


def _farthest(rows: Floats, joints: Floats) -> float:
    """How far the tool can be from a revolute axis; ``rows`` are those after its move, the last is up to the tool."""
    far, parallel = 0.0, True
    for k, row in enumerate(rows):
        x, y, z = row[layout.NOMINAL + 9 : layout.NOMINAL + 12].tolist()
        far += math.hypot(x, y) if parallel else math.hypot(x, y, z)
        parallel = parallel and abs(row[layout.NOMINAL + 8]) > PARALLEL
        if k + 1 < len(rows) and row[layout.KIND] and not parallel:  # a prismatic move along z
            joint = joints[int(row[layout.JOINT])]
            far += abs(row[layout.RATIO]) * max(abs(joint[layout.LOWER]), abs(joint[layout.UPPER]))
    return far


TASKS = {3: "position", 5: "axis", 6: "pose"}  # by the number of rows that come first


@dataclass(frozen=True)
class Stated:
    """Task and limits of a program; of each joint (n,) the largest correction, its most rate and its most acceleration.

    ``held_joints`` (from 0) are those that it leaves as they are wanted.

    Units rad or m, per second and per second squared; ``farthest_m`` is the largest correction of the tool point.
    """

    task: str
    at_limit: Literal["saturate", "refuse"]
    largest: Floats
    farthest_m: float
    rate: Floats
    acceleration: Floats
    held_joints: tuple[int, ...]


def read_program_limits(program: CorrectionProgram) -> Stated:
    """What the program promises."""
    joints, scalars = program.array[program.moves + 1 : program.moves + 1 + program.n_joints], program.array[-1]
    return Stated(
        task=TASKS[int(scalars[layout.FIRST])],
        at_limit="saturate" if scalars[layout.SATURATES] else "refuse",
        largest=joints[:, layout.LARGEST].copy(),
        farthest_m=float(scalars[layout.FARTHEST]),
        rate=joints[:, layout.CHANGE].copy(),
        acceleration=joints[:, layout.SPURT].copy(),
        held_joints=tuple(np.flatnonzero(joints[:, layout.FREE] == 0.0).tolist()),
    )
