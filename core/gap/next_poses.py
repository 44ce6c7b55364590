"""What to measure next (E8): poses, loads and directions that tell two explanations apart, by greedy information.

For an effect with signature w and its rival, lambda (1 - rho²) is what is left of w after geometry, the other effects
and the rival: the inverse of w's entry in the inverse information matrix. Poses are picked one by one for the largest
gain. Repeating old poses under another load or direction is compared first, since it often beats any new pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.gap.candidates import Candidate
from core.gap.source import ToolSource
from core.gap.world import World
from core.measurement import Measurement
from core.observations import Observations
from core.robot import Robot

Floats = NDArray[np.float64]

POOL = 250
WIDEST_RAD = np.pi
MARGIN_SHARE = 0.03  # of the joint range kept free at both ends
CHANGE_FIRST = 0.9  # a condition change is proposed first from this share of the new poses' information
SPARE_LOAD = 0.1  # of the arm's mass, where no load was ever carried


@dataclass(frozen=True)
class Proposal:
    """Poses to measure: conditions per row, and information about the question after each, before being ``before``."""

    rows: Observations
    kind: str
    change: str
    before: float
    after: tuple[float, ...]


def separate(
    world: World, rows: Observations, target: Candidate, rivals: Sequence[Candidate], others: Sequence[int],
    amplitudes: Floats, count: int, seed: int,
) -> tuple[Proposal, ...]:  # fmt: skip
    """Best poses for telling ``target`` (with its fitted ``amplitudes``) from its rivals, best proposal first.

    ``others`` are library columns of the other named effects. Only tool measurements can be planned for.
    """
    source = world.setting.source
    if not isinstance(source, ToolSource) or count < 1:
        return ()
    question = _Question(world, target, tuple(k for c in rivals for k in c.columns), tuple(others), amplitudes)
    rng = np.random.default_rng(seed)
    new = _greedy(question, _pool(rows, source, rng), count, "new", "")
    changed = [_greedy(question, old, count, "repeat", change) for change, old in _changes(rows, source, rng)]
    best = max(changed, key=lambda p: p.after[-1], default=None)
    if best is None:
        return (new,)
    return (best, new) if best.after[-1] >= CHANGE_FIRST * new.after[-1] else (new, best)


def rows_of(proposals: Sequence[Proposal], names: tuple[str, str], robot: Robot) -> list[dict[str, Any]]:
    """Proposals as documents: joint angles in degrees (slides in mm), load, directions, how much more they would tell."""
    scale = wire_scale(robot)
    return [_row(p, k, names, scale) for p in proposals for k in range(len(p.rows))]


def wire_scale(robot: Robot) -> Floats:
    """What a joint value (n,) in SI is multiplied by for ``q_deg``: to degrees, a slide's to mm."""
    return np.array([1e3 if joint.kind == "prismatic" else 180.0 / np.pi for joint in robot.joints])


def _row(p: Proposal, k: int, names: tuple[str, str], scale: Floats) -> dict[str, Any]:
    return {
        "kind": p.kind, "change": p.change or None,
        "q_deg": [round(float(v), 3) for v in p.rows.q[k] * scale],
        "payload_kg": None if p.rows.payload_kg is None else float(p.rows.payload_kg[k]),
        "direction": None if p.rows.direction is None else [int(s) for s in p.rows.direction[k]],
        "separates": list(names), "information_factor": round(float(p.after[k] / max(p.before, 1e-12)), 3),
    }  # fmt: skip


@dataclass(frozen=True)
class _Question:
    """The information matrix so far and how to get rows of it."""

    world: World
    target: Candidate
    rivals: tuple[int, ...]
    others: tuple[int, ...]
    amplitudes: Floats

    def columns(self, G: Floats, W: Floats) -> Floats:
        """Signature of the target first, then geometry, rivals, others, each scaled to order one."""
        source = self.world.setting.source
        signature = W[..., list(self.target.columns)] @ self.amplitudes
        free = [k for k in dict.fromkeys((*self.rivals, *self.others)) if k not in self.target.columns]
        return np.concatenate(
            [signature[..., None], G * source.prior_sigma, W[..., free] * source.library_sigma[free]], axis=-1
        )

    def information(self) -> Floats:
        """Information matrix of what was measured, priors on everything but the target."""
        world = self.world
        X = self.columns(world.G, world.W_raw * world.size)
        H = X.T @ X
        H[np.diag_indices_from(H)] += np.r_[1e-9 * max(H[0, 0], 1e-9), np.ones(len(H) - 1)]
        return H

    def rows(self, observations: Observations) -> Floats:
        """Whitened columns (V, m, p) of poses not measured yet."""
        source = self.world.setting.source
        assert isinstance(source, ToolSource)
        linear = source.on(_imagined(source, observations, self.world.values)).linear(self.world.values)
        noise = self.world.setting.noise.row
        L = np.linalg.inv(np.linalg.cholesky(noise + 1e-18 * np.eye(len(noise))))
        return self.columns(L @ linear.G, L @ linear.W)


def _greedy(question: _Question, pool: Observations, count: int, kind: str, change: str) -> Proposal:
    C = np.linalg.inv(question.information())
    before = 1.0 / C[0, 0]
    X = question.rows(pool)
    picked: list[int] = []
    after = []
    for _ in range(min(count, len(pool))):
        XC = X @ C
        S = np.eye(X.shape[1]) + XC @ X.transpose(0, 2, 1)
        gain = np.einsum("vi,vi->v", XC[:, :, 0], np.linalg.solve(S, XC[:, :, :1])[..., 0])
        gain[picked] = -1.0
        best = int(np.argmax(gain))
        picked.append(best)
        C = C - XC[best].T @ np.linalg.solve(S[best], XC[best])
        after.append(1.0 / float(C[0, 0]))
    return Proposal(pool.select(np.array(picked, dtype=np.int64)), kind, change, before, tuple(after))


def _imagined(source: ToolSource, rows: Observations, values: Floats) -> Measurement:
    """Measurements exactly as the model predicts, of the same kind as the real ones."""
    prediction = source.model.predict(rows, values)
    shape = source.measurement.marker_points
    if shape is not None:
        markers = prediction.position[:, None, :] + np.einsum("nij,mj->nmi", prediction.rotation, shape)
        return Measurement(replace(rows, markers=markers), shape)
    rotation = None if source.measurement.observations.rotation is None else prediction.rotation
    return Measurement(replace(rows, position=prediction.position, rotation=rotation))


def _pool(rows: Observations, source: ToolSource, rng: np.random.Generator) -> Observations:
    """Random poses in the joint ranges, under the loads and directions that were used before."""
    low, high = _ranges(rows, source)
    q = rng.uniform(low, high, size=(POOL, rows.q.shape[1]))
    loads = [0.0] if rows.payload_kg is None else np.unique(rows.payload_kg).tolist()
    made = _conditions(rows, q, rng.choice(loads, POOL))
    if rows.direction is None:
        return made
    used = np.unique(rows.direction, axis=0)
    return replace(made, direction=used[rng.integers(len(used), size=POOL)])


def _ranges(rows: Observations, source: ToolSource) -> tuple[Floats, Floats]:
    limits = source.model.robot.limits
    seen_low, seen_high = rows.q.min(axis=0), rows.q.max(axis=0)
    low = np.where(np.isfinite(limits[:, 0]), np.maximum(limits[:, 0], -WIDEST_RAD), seen_low)
    high = np.where(np.isfinite(limits[:, 1]), np.minimum(limits[:, 1], WIDEST_RAD), seen_high)
    margin = MARGIN_SHARE * (high - low)
    return low + margin, high - margin


def _changes(rows: Observations, source: ToolSource, rng: np.random.Generator) -> list[tuple[str, Observations]]:
    """Old poses under another load, and from the other side."""
    first = np.unique(rows.pose_groups(), return_index=True)[1]
    index = np.sort(rng.permutation(first)[:POOL])
    q = rows.q[index]
    direction = None if rows.direction is None else rows.direction[index]
    load = np.zeros(len(q)) if rows.payload_kg is None else rows.payload_kg[index]
    out = []
    other = _other_load(load, source)
    words = f"repeat these poses with {', '.join(f'{v:.3g} kg' for v in np.unique(other))}"
    out.append((words, replace(_conditions(rows, q, other), direction=direction)))
    if direction is not None:
        words = "repeat these poses approached from the other side"
        out.append((words, replace(_conditions(rows, q, load), direction=-direction)))
    return out


def _other_load(load: Floats, source: ToolSource) -> Floats:
    used = np.unique(load)
    mass = sum(link.mass for link in source.model.robot.links)
    spare = max(float(np.round(SPARE_LOAD * mass, 1)), 0.1)
    if len(used) > 1:
        return np.asarray(np.where(load == used[0], used[-1], used[0]))
    return np.full(len(load), 0.0 if used[0] > 0.0 else spare)


def _conditions(rows: Observations, q: Floats, load: Floats) -> Observations:
    """Rows at ``q`` with the load, at rest, and everything else at its mean."""

    def mean(values: Floats | None) -> Floats | None:
        return None if values is None else np.full((len(q), *values.shape[1:]), values.mean(axis=0))

    return Observations(
        q=q, payload_kg=load, temperature_c=mean(rows.temperature_c), t=mean(rows.t),
        session=None if rows.session is None else np.full(len(q), rows.session[-1]),
        qd=None if rows.qd is None else np.zeros_like(q), qdd=None if rows.qdd is None else np.zeros_like(q),
        payload_com=mean(rows.payload_com), direction=None if rows.direction is None else np.zeros_like(q),
    )  # fmt: skip
