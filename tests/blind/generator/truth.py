"""What was hidden, how visible it was, and which other names look like it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import Arm
from tests.blind.generator.causes import KNOTS, payload_error
from tests.blind.generator.library import CURVE, LIBRARY, Candidate, library
from tests.blind.generator.physics import Physics
from tests.blind.generator.sizing import Lens, Response, Rival, displacement, rivals, signatures, span
from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]
CLOSE = 0.5  # rivals less alike than this are not worth listing
NESTED = 0.999  # from here on an effect lies within its rival's space: then the rival counts however supple it is
STRONG, DECIDABLE = 30.0, 11.0  # lambda, and lambda (1 - rho), from which a name is demanded


@dataclass(frozen=True)
class TruthEffect:
    """A hidden effect. Joints from 1. ``lam`` after geometry, ``lam_partial`` after the other hidden effects too.

    ``joint_lam`` is ``lam`` of each joint's own part beside those of the other joints: what they imitate nobody can tell.
    ``rivals`` are the library's candidates by likeness, best first;
    ``parameters`` are SI by symbol and joint (0: the whole arm), in the library's signs; ``freedom`` is how many a
    finder needs to follow it.
    """

    id: str
    joints: tuple[int, ...]
    inside: bool
    lam: float
    lam_partial: float
    joint_lam: dict[int, float]
    rivals: tuple[Rival, ...]
    parameters: dict[str, float]
    freedom: int
    rms_mm: float

    @property
    def rho(self) -> float:
        """Likeness of the nearest other name that is no more supple: with enough parameters anything looks alike.

        A name whose space holds the effect whole counts, however supple; unless it is a curve that names no cause.
        """
        near = (r.rho for r in self.rivals if r.freedom <= self.freedom + 1 or (r.rho > NESTED and r.id != CURVE))
        return max(near, default=0.0)

    @property
    def decidable(self) -> bool:
        """Whether the effect stands out of noise and rivals enough for its name to be demanded."""
        return self.lam_partial >= STRONG and self.lam_partial * (1.0 - self.rho) >= DECIDABLE


@dataclass(frozen=True)
class Background:
    """A slow motion behind the effects. ``overstated``: how much too large it makes pooled repeats."""

    kind: str
    id: str | None
    lam: float
    overstated: float
    rms_mm: float


@dataclass(frozen=True)
class Truth:
    """What was hidden, and noise and error as they were. ``payload_wrong``: mass or place of the payload is not as told."""

    effects: tuple[TruthEffect, ...]
    expectation: str
    undecidable: tuple[tuple[str, tuple[int, ...]], ...]
    background: Background | None
    mass_error: float
    payload_wrong: bool
    noise_mm: float
    outlier_rows: tuple[int, ...]

    def to_document(self) -> dict[str, Any]:
        """JSON-able form, for the record of a run, with what the score needs of each effect."""
        out = asdict(self)
        for row, effect in zip(out["effects"], self.effects, strict=True):
            row["rho"] = effect.rho
        return out


@dataclass(frozen=True)
class Acting:
    """An effect at work: its name, joints from 0, physics and amplitudes."""

    id: str
    joints: tuple[int, ...]
    physics: Physics
    values: Floats


def sized_up(arm: Arm, visits: Visits, lens: Lens, acting: list[Acting], slow: Physics | None) -> list[TruthEffect]:
    """Size every effect beside the others and beside the slow background, and list its rivals."""
    if not acting:
        return []
    response = Response.of(arm, visits)
    candidates = [(name, joints, signatures(response, lens, p)) for name, joints, p in _candidates(arm, visits, acting)]
    moved = [displacement(arm, visits, a.physics, a.values) for a in acting]
    left = np.stack([lens.left(m) for m in moved], axis=1)
    spans = [signatures(response, lens, a.physics) for a in acting]
    behind = [] if slow is None else [signatures(response, lens, slow)]
    out = []
    for k, a in enumerate(acting):
        rest = [*behind, *(s for i, s in enumerate(spans) if i != k)]
        others = np.concatenate([np.zeros((len(left), 0)), *rest], axis=1)
        beside = span(others) if others.size else others
        partial = left[:, k] - beside @ (beside.T @ left[:, k])
        near = rivals((a.id, a.joints), left[:, k], candidates, others)
        out.append(
            TruthEffect(
                id=a.id,
                joints=tuple(j + 1 for j in a.joints),
                inside=a.id in LIBRARY or a.id == "payload_error",
                lam=float(np.sum(left[:, k] ** 2)),
                lam_partial=float(np.sum(partial**2)),
                joint_lam=_by_joint(arm, visits, lens, a),
                rivals=tuple(replace(r, joints=tuple(j + 1 for j in r.joints)) for r in near if r.rho > CLOSE)[:40],
                parameters={f"{s}_{j + 1}": float(v) for (s, j), v in zip(a.physics.names, a.values, strict=True)},
                freedom=3 * KNOTS if a.id == "random_walk" else len(a.values),
                rms_mm=size_mm(moved[k]),
            )
        )
    return out


def size_mm(moved: Floats) -> float:
    """Root mean square length of displacements (V, 3) m, in mm."""
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))) * 1e3


def _candidates(arm: Arm, visits: Visits, acting: list[Acting]) -> list[Candidate]:
    """The library, and a wrong payload where the compliance of one joint would show it."""
    soft = [a for a in acting if a.id == "axial_compliance" and len(a.joints) == 1 and np.ptp(visits.payload_kg) > 0.0]
    wrong = [("payload_error", (), payload_error(arm, visits, a.joints, float(a.values[0]))) for a in soft]
    return [*library(arm, visits), *wrong]


def _by_joint(arm: Arm, visits: Visits, lens: Lens, a: Acting) -> dict[int, float]:
    at = np.array([j for _, j in a.physics.names])
    joints = sorted({int(j) for j in at if j >= 0})
    own = [lens.left(displacement(arm, visits, a.physics, np.where(at == j, a.values, 0.0))) for j in joints]
    out = {}
    for k, j in enumerate(joints):
        others = (
            np.stack([o for i, o in enumerate(own) if i != k], axis=1) if len(own) > 1 else np.zeros((len(own[k]), 0))
        )
        beside = span(others)
        out[j + 1] = float(np.sum((own[k] - beside @ (beside.T @ own[k])) ** 2))
    return out
