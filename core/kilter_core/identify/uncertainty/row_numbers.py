"""What each row of a fit says, in as many numbers as it follows.

A view has two numbers for each corner and follows sixteen at most: the tool's six and those of lens and scale. What is left of
the others is noise of corners that no error of the arm moves. Read with the rest, 96 numbers of a few dozen views hide how
poses scatter, and corners that are far off look like poses that are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.uncertainty.settling import levers
from kilter_core.measurement.kind import Spanned
from kilter_core.types import Bools, Floats


@dataclass(frozen=True)
class RowNumbers:
    """Derivatives ``A (N, R, F)`` in prior sigmas, residuals ``r (N, R)`` and levers of the joints ``L (N, R, n)``, whitened;
    ``told (N, R)`` says which numbers each row has, and ``group`` (R) of which noise group they are.
    """

    A: Floats
    r: Floats
    L: Floats
    told: Bools
    group: tuple[str, ...]

    @staticmethod
    def from_fit(fit: Fit) -> RowNumbers:
        """Of the rows of a fit; views in a fit whose numbers are shortened already, and rows of a filter, as they are."""
        problem, rows = fit.problem, len(fit.problem.measurement.observations)
        here = problem.linearise(fit.values, fit.residual)
        A, r = problem.by_row(here)
        L, start, parts = levers(fit), 0, []
        for block, root in zip(fit.residual.blocks, problem.roots(fit.residual), strict=True):
            each = problem.block_size(block) // rows
            own = slice(start, start + each)
            start += each
            told = ~np.isnan(block.r).reshape(rows, -1)
            part = RowNumbers(A[:, own], r[:, own], L[:, own], told[:, :each], (block.group,) * each)
            if isinstance(block.slopes, Spanned) and each == told.shape[1]:  # not shortened yet
                part = part.project_on_span(block.slopes.span, root, told)
            parts.append(part)
        return RowNumbers(
            np.concatenate([p.A for p in parts], axis=1),
            np.concatenate([p.r for p in parts], axis=1),
            np.concatenate([p.L for p in parts], axis=1),
            np.concatenate([p.told for p in parts], axis=1),
            tuple(group for p in parts for group in p.group),
        )

    def project_on_span(self, span: Floats, root: Floats | None, told: Floats) -> RowNumbers:
        """As the numbers that move along a ``span (N, R, k)``, each row's own; a robust loss weighs them by a ``root``."""
        weight = (
            np.ones(told.shape) if root is None else np.broadcast_to(root, (*root.shape[:2], 2)).reshape(told.shape)
        )
        weight = weight * told
        Q = np.linalg.qr(span * weight[:, :, None])[0].transpose(0, 2, 1)
        some = np.repeat(told.any(axis=1, keepdims=True), Q.shape[1], axis=1)
        A, r, L = Q @ self.A, (Q @ self.r[:, :, None])[:, :, 0], Q @ (weight[:, :, None] * self.L)
        return RowNumbers(A, r, L, some, self.group[:1] * Q.shape[1])
