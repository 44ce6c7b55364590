"""How visible an effect is once geometry has been fitted again: non-centrality, and its likeness to other effects."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import Arm, Deflection
from tests.blind.generator.physics import Physics
from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]

STEP = 1e-5  # m or rad of the central differences
RANK = 1e-7  # below this part of the largest singular value a direction is the rounding of the differences
LARGEST_M = 3e-3  # no effect is made to move the tool further than this, however invisible it stays
VANISHING = 1e-3  # share of a signature, below which geometry has swallowed it

# Two names for what no position measurement can tell apart.
TWINS = {"backlash": "friction_windup", "friction_windup": "backlash"}


@dataclass(frozen=True)
class Lens:
    """What is left of displacements, noise whitened by ``whitener (V, 3, 3)``, geometry fitted by ``basis (3V, r)``."""

    whitener: Floats
    basis: Floats

    @staticmethod
    def of(arm: Arm, visits: Visits, covariance: Floats) -> Lens:
        """Look through the geometric Jacobian of ``arm``, differenced over every redundant error, foot and tool.

        Visits that a finder holds out count nothing; visits without a motion between them count as one.
        """
        shots = np.bincount(visits.approach)[visits.approach]
        weight = np.where(visits.searched, 1.0 / np.sqrt(shots), 0.0)
        whitener = np.linalg.inv(np.linalg.cholesky(covariance)) * weight[:, None, None]
        count = 6 * (arm.n + 3)
        columns = []
        for k in range(count):
            e = np.zeros(count)
            e[k] = STEP
            columns.append((arm.varied(e).positions(visits.q) - arm.varied(-e).positions(visits.q)) / (2.0 * STEP))
        lens = Lens(whitener, np.zeros((3 * len(visits), 0)))
        return Lens(whitener, span(np.stack([lens.whiten(c) for c in columns], axis=1)))

    def whiten(self, displacement: Floats) -> Floats:
        """Displacements (V, 3) m in units of their noise, flat (3V,)."""
        return np.asarray(np.einsum("vij,vj->vi", self.whitener, displacement).reshape(-1))

    def left(self, displacement: Floats) -> Floats:
        """Whitened part (3V,) that geometry cannot take up."""
        w = self.whiten(displacement)
        return np.asarray(w - self.basis @ (self.basis.T @ w))


def span(columns: Floats, rank: float = RANK) -> Floats:
    """Orthonormal basis of columns."""
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, s > rank * max(float(s[0]), 1e-300)]) if len(s) else np.zeros((len(columns), 0))


def displacement(arm: Arm, visits: Visits, physics: Physics, values: Floats) -> Floats:
    """What an effect alone does to the tool point (V, 3) m, finite motions and all."""
    d = Deflection.none(len(visits), arm.n)
    physics.act(values, d)
    return arm.positions(visits.q, d) - arm.positions(visits.q)


def sized(arm: Arm, visits: Visits, lens: Lens, physics: Physics, lam: float, rng: np.random.Generator) -> Floats:
    """Amplitudes (P,), random within their kind, whose non-centrality after geometry is ``lam``.

    Displacement and amplitudes are capped: an effect that geometry swallows, or a constant temperature, stays as small
    as real ones are, and below ``lam``.
    """
    values = physics.typical * rng.uniform(0.5, 1.5, len(physics.typical))
    if not physics.positive:
        values = values * rng.choice([-1.0, 1.0], len(values))
    for _ in range(3):
        moved = displacement(arm, visits, physics, values)
        size = float(np.sum(lens.left(moved) ** 2))
        farthest = float(np.linalg.norm(moved, axis=1).max())
        values = values * min(np.sqrt(lam / max(size, 1e-30)), LARGEST_M / max(farthest, 1e-30))
        values = np.clip(values, -physics.largest, physics.largest)
    return np.asarray(values)


@dataclass(frozen=True)
class Response:
    """Motion of the tool point by each entry of a deflection, differenced: name and place -> (V, 3)."""

    arm: Arm
    visits: Visits
    columns: tuple[tuple[str, tuple[int, ...], Floats], ...]

    @staticmethod
    def of(arm: Arm, visits: Visits) -> Response:
        """Difference the arm by every entry, the same at all visits."""
        still = arm.positions(visits.q)
        columns = []
        for entry in fields(Deflection):
            shape = getattr(Deflection.none(1, arm.n), entry.name).shape[1:]
            for place in np.ndindex(*shape):
                d = Deflection.none(len(visits), arm.n)
                getattr(d, entry.name)[(slice(None), *place)] = STEP
                columns.append((entry.name, place, (arm.positions(visits.q, d) - still) / STEP))
        return Response(arm, visits, tuple(columns))

    def to(self, d: Deflection) -> Floats:
        """Displacement (V, 3) m to first order."""
        out = np.zeros((len(self.visits), 3))
        for name, place, column in self.columns:
            amount = getattr(d, name)[(slice(None), *place)]
            if amount.any():
                out += amount[:, None] * column
        return out


def signatures(response: Response, lens: Lens, physics: Physics) -> Floats:
    """Whitened, projected columns (3V, P) of an effect's parameters, without those that geometry takes up whole."""
    columns = []
    for k, typical in enumerate(physics.typical):
        values = np.zeros(len(physics.typical))
        values[k] = typical
        d = Deflection.none(len(response.visits), response.arm.n)
        physics.act(values, d)
        moved = response.to(d)
        left = lens.left(moved)
        if np.linalg.norm(left) > VANISHING * np.linalg.norm(lens.whiten(moved)):
            columns.append(left)
    return np.stack(columns, axis=1) if columns else np.zeros((3 * len(response.visits), 0))


@dataclass(frozen=True)
class Rival:
    """Another name of the library and the part ``rho`` of an effect's signature that it can imitate."""

    id: str
    joints: tuple[int, ...]
    rho: float
    freedom: int


def _same(a: tuple[str, tuple[int, ...]], b: tuple[str, tuple[int, ...]]) -> bool:
    """Whether two candidates are one effect: same id or its twin, on joints of which some are the same."""
    if b[0] not in (a[0], TWINS.get(a[0])):
        return False
    return a[1] == b[1] if a[0] == "joint_coupling" else bool(set(a[1]) & set(b[1])) or a[1] == b[1]


def rivals(
    own: tuple[str, tuple[int, ...]], w: Floats, candidates: list[tuple[str, tuple[int, ...], Floats]], others: Floats
) -> list[Rival]:
    """Likeness of every other candidate to ``w (3V,)``, both seen beside the other hidden effects ``others (3V, k)``.

    A family that contains the effect itself, and its twin in name, are not rivals.
    """
    beside = span(others) if others.shape[1] else others
    w = w - beside @ (beside.T @ w)
    found = []
    for name, joints, columns in candidates:
        if _same(own, (name, joints)) or columns.shape[1] == 0 or not np.any(w):
            continue
        free = columns - beside @ (beside.T @ columns)
        kept = np.linalg.norm(free, axis=0) > VANISHING * np.linalg.norm(columns, axis=0)
        if not np.any(kept):
            continue
        B = span(free[:, kept] / np.linalg.norm(free[:, kept], axis=0), 1e-6)
        found.append(Rival(name, joints, float(np.linalg.norm(B.T @ w) / np.linalg.norm(w)), B.shape[1]))
    return sorted(found, key=lambda r: -r.rho)
