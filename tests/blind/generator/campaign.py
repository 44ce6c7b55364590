"""From a case to what Kilter gets (a robot document and columns) and what is kept from it (the truth)."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator import tracker
from tests.blind.generator.arm import Arm, Deflection, built
from tests.blind.generator.arms import ARMS
from tests.blind.generator.cases import Case, Hidden
from tests.blind.generator.outside import OUTSIDE
from tests.blind.generator.physics import LIBRARY, Physics
from tests.blind.generator.sizing import Lens, Response, Rival, displacement, library, rivals, signatures, sized, span
from tests.blind.generator.visits import Options, Visits, plan

Floats = NDArray[np.float64]
UNSETTLED = 3.0  # lambda (1 - rho) up to which two names stay a toss-up: wrong one time in nine at best
CLOSE = 0.5  # rivals less alike than this are not worth listing


@dataclass(frozen=True)
class TruthEffect:
    """A hidden effect. Joints from 1. ``lam`` after geometry, ``lam_partial`` after the other hidden effects too.

    ``joint_lam`` is ``lam`` of each joint's own part. ``rivals`` are the library's candidates by likeness, best first;
    ``parameters`` are SI by symbol and joint (0: the whole arm), in the library's signs.
    """

    id: str
    joints: tuple[int, ...]
    inside: bool
    lam: float
    lam_partial: float
    joint_lam: dict[int, float]
    rivals: tuple[Rival, ...]
    parameters: dict[str, float]
    rms_mm: float

    @property
    def rho(self) -> float:
        """Likeness of the nearest other name that is no more supple: with enough parameters anything looks alike."""
        return max((r.rho for r in self.rivals if r.freedom <= len(self.parameters) + 1), default=0.0)


@dataclass(frozen=True)
class Truth:
    """What was hidden, and noise and error as they were."""

    effects: tuple[TruthEffect, ...]
    expectation: str
    undecidable: tuple[tuple[str, tuple[int, ...]], ...]
    wrong_masses: bool
    noise_mm: float
    outlier_rows: tuple[int, ...]

    def to_document(self) -> dict[str, Any]:
        """JSON-able form, for the record of a run."""
        return asdict(self)


@dataclass(frozen=True)
class Campaign:
    """A robot document, observation columns of the contract (name -> array), and the truth about them."""

    case: Case
    document: dict[str, Any]
    columns: dict[str, NDArray[Any]]
    truth: Truth


@dataclass(frozen=True)
class _Scene:
    arm: Arm
    visits: Visits
    lens: Lens
    options: Options


def generate(case: Case) -> Campaign:
    """Build the arm, measure it, and size what is hidden in it; the same case gives the same numbers."""
    rng = np.random.default_rng(case.seed)
    drawn = ARMS[case.robot]()
    arm = built(drawn, rng)
    visits = plan(arm, case.poses, case.options, rng)
    covariance = tracker.visit_covariance(arm.positions(visits.q), case.options)
    scene = _Scene(arm, visits, Lens.of(arm, visits, covariance), case.options)
    chosen = [(h, physics_of(h, arm, visits, rng)) for h in case.hidden]
    values = [_amplitudes(scene, h, p, lam, rng) for (h, p), lam in zip(chosen, case.lam, strict=True)]
    total = Deflection.none(len(visits), arm.n)
    for (_, physics), amplitude in zip(chosen, values, strict=True):
        physics.act(amplitude, total)
    readings, wrong = tracker.read(arm.positions(visits.q, total), case.options, rng)
    off = rng.uniform(0.8, 1.2, arm.n) if case.options.wrong_masses else np.ones(arm.n)
    columns, order = _columns(visits, readings)
    effects = tuple(_truths(scene, chosen, values))
    undecidable = tuple((h.id, tuple(j + 1 for j in h.joints)) for h in case.undecidable)
    settled = len(undecidable) > 1 and _settled(effects[0], undecidable[1])
    truth = Truth(
        effects=effects,
        expectation="named" if settled else case.expectation,
        undecidable=() if settled else undecidable,
        wrong_masses=case.options.wrong_masses,
        noise_mm=float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)))) * 1e3,
        outlier_rows=tuple(int(i) for i in np.flatnonzero(wrong.reshape(-1)[order])),
    )
    return Campaign(case, drawn.document(drawn.mass * off), columns, truth)


def _settled(effect: TruthEffect, other: tuple[str, tuple[int, ...]]) -> bool:
    """Whether the data of these poses tell an effect from its alias after all."""
    rho = max((r.rho for r in effect.rivals if (r.id, r.joints) == other), default=0.0)
    return effect.lam_partial * (1.0 - rho) > UNSETTLED


def physics_of(hidden: Hidden, arm: Arm, visits: Visits, rng: np.random.Generator) -> Physics:
    """The physics of an effect, of the library or outside it."""
    if hidden.id in OUTSIDE:
        return OUTSIDE[hidden.id](arm, visits, hidden.joints, rng)
    return LIBRARY[hidden.id](arm, visits, hidden.joints)


# What geometry swallows whole cannot be sized by what is left of it: amplitudes as real arms and trackers have them.
SWALLOWED = {"measurement_scale": 5e-5, "backlash": np.radians(0.03)}


def _amplitudes(scene: _Scene, hidden: Hidden, physics: Physics, lam: float, rng: np.random.Generator) -> Floats:
    one_sided = hidden.id == "backlash" and scene.options.approach == "one_sided"
    if one_sided or hidden.id == "measurement_scale":
        return np.full(len(physics.names), -SWALLOWED[hidden.id])
    values = sized(scene.arm, scene.visits, scene.lens, physics, lam, rng)
    return -np.abs(values) if hidden.id == "backlash" else values


def _truths(scene: _Scene, chosen: list[tuple[Hidden, Physics]], values: list[Floats]) -> list[TruthEffect]:
    arm, visits, lens = scene.arm, scene.visits, scene.lens
    if not chosen:
        return []
    response = Response.of(arm, visits)
    candidates = [(name, joints, signatures(response, lens, p)) for name, joints, p in library(arm, visits)]
    moved = [displacement(arm, visits, p, a) for (_, p), a in zip(chosen, values, strict=True)]
    left = np.stack([lens.left(m) for m in moved], axis=1)
    spans = [signatures(response, lens, p) for _, p in chosen]
    out = []
    for k, ((hidden, physics), amplitude) in enumerate(zip(chosen, values, strict=True)):
        others = np.concatenate([np.zeros((len(left), 0)), *(s for i, s in enumerate(spans) if i != k)], axis=1)
        beside = span(others) if others.size else others
        partial = left[:, k] - beside @ (beside.T @ left[:, k])
        near = rivals((hidden.id, hidden.joints), left[:, k], candidates, others)
        out.append(
            TruthEffect(
                id=hidden.id,
                joints=tuple(j + 1 for j in hidden.joints),
                inside=hidden.id in LIBRARY,
                lam=float(np.sum(left[:, k] ** 2)),
                lam_partial=float(np.sum(partial**2)),
                joint_lam=_by_joint(scene, physics, amplitude),
                rivals=tuple(replace(r, joints=tuple(j + 1 for j in r.joints)) for r in near if r.rho > CLOSE)[:40],
                parameters={
                    f"{symbol}_{j + 1}": float(a) for (symbol, j), a in zip(physics.names, amplitude, strict=True)
                },
                rms_mm=float(np.sqrt(np.mean(np.sum(moved[k] ** 2, axis=1)))) * 1e3,
            )
        )
    return out


def _by_joint(scene: _Scene, physics: Physics, amplitude: Floats) -> dict[int, float]:
    at = np.array([j for _, j in physics.names])
    out = {}
    for j in sorted({int(j) for j in at if j >= 0}):
        own = displacement(scene.arm, scene.visits, physics, np.where(at == j, amplitude, 0.0))
        out[j + 1] = float(np.sum(scene.lens.left(own) ** 2))
    return out


def _columns(visits: Visits, readings: Floats) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Columns of the contract, one row per reading in the order of time, and that order."""
    repeats = readings.shape[1]

    def rows(x: NDArray[Any]) -> NDArray[Any]:
        return np.repeat(x, repeats, axis=0)

    columns: dict[str, NDArray[Any]] = {}
    q, direction = rows(np.degrees(visits.q)), rows(visits.direction)
    for i in range(q.shape[1]):
        columns[f"q{i + 1}_deg"] = q[:, i]
    for i, axis in enumerate("xyz"):
        columns[f"{axis}_mm"] = readings.reshape(-1, 3)[:, i] * 1e3
    for i in range(q.shape[1]):
        columns[f"dir{i + 1}"] = direction[:, i].astype(np.int64)
    columns["t_s"] = rows(visits.t_s) + np.tile(np.arange(repeats), len(visits)) * 0.5
    columns["payload_kg"], columns["temperature_c"] = rows(visits.payload_kg), rows(visits.temperature_c)
    columns["session"], columns["pose_id"] = rows(visits.session), rows(visits.pose)
    order = np.argsort(columns["t_s"], kind="stable")
    return {name: column[order] for name, column in columns.items()}, order
