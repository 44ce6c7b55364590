"""Whether the stored chain lacks a direction that its complete form has: geometry is asked before physics is believed.

A chain in DH form has one angle between neighbouring axes where two are needed as these come near parallel (Hayati 1983).
What it cannot express is otherwise explained by the effect that resembles it most. Each axis is tilted about both normals
of itself, geometry is projected off, and what is left of the tilt is tested like any other column (score test, F).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f

from kilter_core.arm.chain import Axis, Element
from kilter_core.errors import FindingDocument
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.parameters import degrees
from kilter_core.types import Floats

STEP_RAD = 1e-5  # of the difference quotient: far above rounding, far below where a tilt is no longer linear
TELLING = 1e-3  # of a tilt's length that the geometry must leave, or the chain has that direction already
MISSED = 1e-4  # chance, over all directions, of saying that a complete chain lacks one


@dataclass(frozen=True)
class MissingDirection:
    """Rotation of the axis of ``joint`` (from 0) about ``axis`` of the frame before it by ``angle`` rad; ``p`` of F."""

    joint: int
    axis: Axis
    angle: float
    p: float

    def words(self) -> str:
        """Name the rotation as a person would look for it."""
        return (
            f"the rotation of axis {self.joint + 1} about {self.axis.name[1].lower()} ({degrees(self.angle):.3g} deg)"
        )


def missing_directions(problem: LinearizedProblem, chosen: Sequence[int]) -> tuple[MissingDirection, ...]:
    """Directions that explain the rows at least as well, number for number, as the effects ``chosen`` do."""
    y, places, columns = problem.y, [], []
    chain = problem.settings.source.model.robot.chain
    for joint, element in enumerate(chain.primary):
        about = chain.elements[element].axis
        for axis in (Axis.RX, Axis.RY, Axis.RZ):
            if axis % 3 == about % 3:
                continue
            raw = _column(problem, element, axis)
            if raw is None:
                return ()
            left = _off(problem, raw)
            if np.linalg.norm(left) > TELLING * max(float(np.linalg.norm(raw)), 1e-300):
                places.append((joint, axis))
                columns.append(left)
    found: list[MissingDirection] = []
    taken, count = np.zeros((len(y), 0)), len(columns)
    for _ in range(count):
        rest = [c - taken @ (taken.T @ c) for c in columns]
        gains = [_gain(c, y) if c @ c > TELLING**2 * (w @ w) else 0.0 for c, w in zip(rest, columns, strict=True)]
        best = int(np.argmax(gains))
        remaining = float(y @ y) - float(np.sum((taken.T @ y) ** 2)) - gains[best]
        nu = problem.nu - len(found) - 1
        p = float(f.sf(gains[best] * nu / max(remaining, 1e-300), 1, nu)) if nu > 0 else 1.0
        if count * p > MISSED:
            break
        angle = -float(rest[best] @ y) / float(rest[best] @ rest[best])
        found.append(MissingDirection(*places[best], angle, p))
        taken = np.column_stack([taken, rest[best] / np.linalg.norm(rest[best])])
    geometry = float(np.sum((taken.T @ y) ** 2)) - len(found) * np.log(problem.rows)
    return tuple(found) if found and geometry >= _physics(problem, chosen) else ()


def incomplete_sentence(found: Sequence[MissingDirection]) -> str:
    """What the headline says of it besides; empty where nothing is missing."""
    if not found:
        return ""
    words = ", ".join(d.words() for d in found)
    return f" But the robot's description lacks {words}, which explains the rows at least as well."


def incomplete_warnings(found: Sequence[MissingDirection]) -> Iterator[FindingDocument]:
    """Say which rotation of which axis the description lacks, before an effect is believed."""
    if found:
        yield FindingDocument.make(
            "geometry_incomplete",
            f"The description of the robot lacks {', '.join(d.words() for d in found)}, which explains the rows at "
            "least as well as any effect: describe the robot with a complete chain (convention poe, cpc or mcpc), and "
            "search again before you believe an effect.",
        )


def _gain(column: Floats, y: Floats) -> float:
    """Chi-square that a column takes off."""
    return float(column @ y) ** 2 / float(column @ column)


def _column(problem: LinearizedProblem, element: int, axis: Axis) -> Floats | None:
    """Whitened derivative (R,) of the residuals by a rotation before an element of the chain; None where none is fitted."""
    sides = []
    for angle in (STEP_RAD, -STEP_RAD):
        tilted = problem.settings.source.with_rotation_before(element, Element(axis, angle))
        if tilted is None:
            return None
        sides.append(problem.settings.whitening.residual(tilted.residual(problem.values)).reshape(-1))
    return np.asarray((sides[0] - sides[1]) / (2.0 * STEP_RAD))


def _off(problem: LinearizedProblem, column: Floats) -> Floats:
    """Take the geometry, and the load errors as far as their priors let them, off a column."""
    w = problem.soft(column[:, None])[:, 0]
    return np.asarray(w - problem.U @ (problem.U.T @ w))


def _physics(problem: LinearizedProblem, chosen: Sequence[int]) -> float:
    """Chi-square that the effects take off, less what as many numbers take by chance (Schwarz 1978)."""
    if not len(chosen):
        return 0.0
    which = list(chosen)
    A, c = problem.A[np.ix_(which, which)], problem.c[which]
    return float(c @ np.linalg.pinv(A, hermitian=True) @ c) - len(which) * float(np.log(problem.rows))
