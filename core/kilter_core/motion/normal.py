"""Normal equations of a log, second by second: all that a search asks of millions of rows.

A block of a second is the unit of independence: rows within it share the noise that the filter and the drive leave. Columns of
friction act on one joint, those of bodies on all; so every joint has the products of its own columns only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kilter_core.motion.layout import Known, Layout, Term
from kilter_core.motion.record import Log, Part
from kilter_core.types import Bools, Floats, Ints

BLOCK_S = 1.0
MOST_BLOCKS = 400


@dataclass(frozen=True)
class Equations:
    """Products of all columns by block: ``products`` has (B, m, m) for each joint, the torque last, with ``places`` of its
    columns in the whole layout; ``rows (B, n)`` counts. ``motion``, ``session`` and ``start_s (B,)`` are those of each
    block.
    """

    layout: Layout
    products: tuple[Floats, ...]
    places: tuple[Ints, ...]
    rows: Floats
    motion: Ints
    session: Ints
    start_s: Floats

    @property
    def base(self) -> int:
        """Number of columns of base parameters; they come first."""
        return len(self.layout.kept)

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms that have columns."""
        return self.layout.terms

    def losses(self, theta: Floats, weights: Floats, blocks: Bools | None = None) -> Floats:
        """Weighted squares (B, n) that the values ``theta (width,)`` leave, of all blocks or of some."""
        out = []
        for j, w in enumerate(weights):
            v = np.append(-theta[self.places[j]], 1.0)
            used = np.flatnonzero(v)
            chosen = self.products[j] if blocks is None else self.products[j][blocks]
            out.append(w * (chosen[:, used][:, :, used] @ v[used] @ v[used] if w else np.zeros(len(chosen))))
        return np.stack(out, axis=1)

    def squares(self, theta: Floats, weights: Floats) -> Floats:
        """Weighted products (B, k, k) of the torques that values ``theta (width, k)`` make."""
        out = np.zeros((len(self.motion), theta.shape[1], theta.shape[1]))
        for j, w in enumerate(weights):
            used = np.flatnonzero(np.any(theta[self.places[j]], axis=1))
            v = theta[self.places[j]][used]
            out += w * (v.T @ self.products[j][:, used][:, :, used] @ v)
        return out

    def scores(self, theta: Floats, weights: Floats) -> Floats:
        """What is left, along every column (B, width), block by block."""
        out = np.zeros((len(self.motion), self.layout.width))
        for j, w in enumerate(weights):
            v = np.append(-theta[self.places[j]], 1.0)
            out[:, self.places[j]] += w * (self.products[j][:, :-1] @ v)
        return out

    def sum_blocks(self, blocks: Bools, weights: Floats) -> tuple[Floats, Floats]:
        """Normal matrix (width, width) and right side (width,) of some blocks."""
        width = self.layout.width
        A, b = np.zeros((width, width)), np.zeros(width)
        for j, w in enumerate(weights):
            total = w * self.products[j][blocks].sum(axis=0)
            A[np.ix_(self.places[j], self.places[j])] += total[:-1, :-1]
            b[self.places[j]] += total[:-1, -1]
        return A, b

    def block_sums(self, columns: Ints, blocks: Bools, weights: Floats) -> tuple[Floats, Floats]:
        """Normal matrices (b, k, k) and right sides (b, k) of some blocks, for some columns of the layout."""
        place = np.full(self.layout.width, -1)
        place[columns] = np.arange(len(columns))
        A = np.zeros((np.count_nonzero(blocks), len(columns), len(columns)))
        b = np.zeros(A.shape[:2])
        for j, w in enumerate(weights):
            own = np.flatnonzero(place[self.places[j]] >= 0)
            there, P = place[self.places[j]][own], self.products[j][blocks]
            A[:, there[:, None], there] += w * P[:, own[:, None], own]
            b[:, there] += w * P[:, own, -1]
        return A, b

    def rms(self, theta: Floats, blocks: Bools) -> Floats:
        """Root mean square (n,) of what the values ``theta (width,)`` leave of each torque in some blocks."""
        squares = self.losses(theta, np.ones(len(self.products)), blocks).sum(axis=0)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0) / np.maximum(self.rows[blocks].sum(axis=0), 1)))

    def torque_squares(self, blocks: Bools) -> Floats:
        """Sum of the squared torques (n,) of some blocks."""
        return np.array([p[blocks, -1, -1].sum() for p in self.products])

    def columns_of(self, terms: Sequence[Term]) -> Ints:
        """Columns of the base parameters and of these terms, in order."""
        return np.concatenate([np.arange(self.base), *(term.columns for term in terms)]).astype(np.int64)


def form_equations(layout: Layout, log: Log, known: Known | None = None, early_s: Sequence[float] = ()) -> Equations:
    """Return the products of the columns of a layout and the torques of a log, which may be read earlier at each joint (n,)."""
    n = layout.robot.n_joints
    sums: list[list[Floats]] = [[] for _ in range(n)]
    rows, motion, session, start_s = [], [], [], []
    length = max(BLOCK_S, sum(float(part.t[-1] - part.t[0]) for part in log.parts()) / MOST_BLOCKS)
    for part in log.parts():
        use = (part.moving & part.usable)[part.rows]
        joints = _smooth_columns(layout, part, known, early_s or (0.0,) * n)
        block = ((part.t[part.rows] - part.t[0]) / length).astype(np.int64)
        edges = np.flatnonzero(np.diff(block, prepend=-1, append=-1))
        for inside in (slice(a, b) for a, b in pairwise(edges.tolist())):
            for j, X in enumerate(joints):
                chosen = X[inside][use[inside, j]]
                sums[j].append(chosen.T @ chosen)
            rows.append(use[inside].sum(axis=0))
            motion.append(part.motion[part.rows][inside][0])
            session.append(part.session)
            start_s.append(part.t[0] + block[inside][0] * length)
    places = tuple(layout.places(j) for j in range(n))
    products = tuple(np.array(one) for one in sums)
    return Equations(layout, products, places, np.array(rows), np.array(motion), np.array(session), np.array(start_s))


def _smooth_columns(layout: Layout, part: Part, known: Known | None, early_s: Sequence[float]) -> list[Floats]:
    """Of each joint its columns and the torque, filtered and thinned."""
    bodies, out = layout.bodies(part), []
    for j, early in enumerate(early_s):
        tau = np.interp(part.t + early, part.t, part.tau[:, j]) if early else part.tau[:, j]
        out.append(
            part.smooth(np.column_stack([layout.joint_columns(part, bodies, j, known), tau - bodies.stated[:, j]]))
        )
    return out
