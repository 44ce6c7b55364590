"""What to measure next (E8): poses, loads and directions that distinguish two explanations, by greedy information.

For an effect with signature w and its rival, lambda (1 - rho²) is what is left of w after geometry, the other effects
and the rival: the inverse of w's entry in the inverse information matrix. Poses are picked one by one for the largest
gain. Repeating old poses under another load or direction is compared first, since it often beats any new pose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.driving_order import driving_order, joint_ranges
from kilter_core.arm.robot import Robot
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.sources.source import Source
from kilter_core.identify.views import PlannedViews
from kilter_core.model import Calibration
from kilter_core.model.region import Region
from kilter_core.observations import Observations
from kilter_core.parameters import DEG, MM, mm
from kilter_core.types import Floats

POOL = 250
WARMER_K = 5.0
LATER_S = 600.0
CHANGE_FIRST = 0.9  # a condition change is proposed first from this share of the new poses' information
ASIDE = "measure again what was set aside"
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
    problem: LinearizedProblem,
    rows: Observations,
    target: Candidate,
    rivals: Sequence[Candidate],
    others: Sequence[int],
    amplitudes: Floats,
    count: int,
    seed: int,
    region: Region | None = None,
    by_views: PlannedViews | None = None,
) -> tuple[Proposal, ...]:
    """Best poses for telling ``target`` (with its fitted ``amplitudes``) from its rivals, best proposal first.

    ``others`` are library columns of the other named effects. New poses are in ``region``, else where ``rows`` were.
    Only tool measurements can be planned for; ``by_views`` tells what a view of each pose would say.
    """
    source = problem.settings.source
    if not source.observes_tool or not source.observes_places or count < 1:
        return ()
    model = Calibration(source.model, problem.values)
    region = region or Region.from_calibration(model, rows.q)
    needs = frozenset[str]().union(*(c.effects[0].needs for c in (target, *rivals)))
    question = _Question(
        problem, target, tuple(k for c in rivals for k in c.columns), tuple(others), amplitudes, by_views
    )
    rng = np.random.default_rng(seed)
    new = _greedy(question, _pool(rows, region, needs, rng), count, "new", "")
    old = rows.select(np.flatnonzero(region.clear(rows.q)))
    changes = _changes(old, source, needs, rng) if len(old) else []
    made = [
        _order_proposal_poses(question, p, needs)
        for p in (new, *(_greedy(question, o, count, "repeat", w) for w, o in changes))
    ]
    best = max(made[1:], key=lambda p: p.after[-1], default=None)
    if best is None:
        return (made[0],)
    return (best, made[0]) if best.after[-1] >= CHANGE_FIRST * made[0].after[-1] else (made[0], best)


def proposal_rows(proposals: Sequence[Proposal], names: tuple[str, str], robot: Robot) -> list[dict[str, Any]]:
    """Proposals as documents: joint angles in degrees (prismatic joints in mm), load, directions and gain."""
    scale = wire_scale(robot)
    return [_row(p, k, names, scale) for p in proposals for k in range(len(p.rows))]


def set_aside_again(rows: Observations, robot: Robot) -> list[dict[str, Any]]:
    """The poses of visits that were set aside, as documents: what errs there again is the arm, and no wrong reading."""
    first = np.sort(np.unique(rows.pose_groups(), return_index=True)[1])
    again = Proposal(rows.select(first), "repeat", ASIDE, 1.0, (1.0,) * len(first))
    scale = wire_scale(robot)
    told = (_row(again, k, ("wrong reading", "error of the arm"), scale) for k in range(len(first)))
    return [row | {"information_factor": None} for row in told]


def wire_scale(robot: Robot) -> Floats:
    """What a joint value (n,) in SI is multiplied by for ``q_deg``: to degrees, a prismatic joint's to mm."""
    return np.array([MM if joint.kind == "prismatic" else DEG for joint in robot.joints])


def _row(p: Proposal, k: int, names: tuple[str, str], scale: Floats) -> dict[str, Any]:
    com = None if p.rows.payload_kg is None or p.rows.payload_com is None else p.rows.payload_com[k]
    place = {} if com is None else {"payload_com_mm": [round(mm(float(v)), 3) for v in com]}
    return place | {
        "kind": p.kind,
        "change": p.change or None,
        "q_deg": [round(float(v), 3) for v in p.rows.q[k] * scale],
        "payload_kg": None if p.rows.payload_kg is None else float(p.rows.payload_kg[k]),
        "direction": None if p.rows.direction is None else [int(s) for s in p.rows.direction[k]],
        "separates": list(names),
        "information_factor": round(float(p.after[k] / max(p.before, 1e-12)), 3),
    }


@dataclass(frozen=True)
class _Question:
    """The information matrix so far and how to get rows of it."""

    problem: LinearizedProblem
    target: Candidate
    rivals: tuple[int, ...]
    others: tuple[int, ...]
    amplitudes: Floats
    by_views: PlannedViews | None = None

    def columns(self, G: Floats, W: Callable[[list[int]], Floats]) -> Floats:
        """Signature of the target first, then geometry, rivals, others, each scaled to order one; ``W`` gives columns."""
        source = self.problem.settings.source
        signature = W(list(self.target.columns)) @ self.amplitudes
        free = [k for k in dict.fromkeys((*self.rivals, *self.others)) if k not in self.target.columns]
        return np.concatenate(
            [signature[..., None], source.prior.columns(G), W(free) * source.library_sigma[free]], axis=-1
        )

    def information(self) -> Floats:
        """Information matrix of what was measured, priors on everything but the target."""
        problem = self.problem
        X = self.columns(problem.G, lambda k: problem.W_raw[:, k] * problem.size[k])
        H = X.T @ X
        H[np.diag_indices_from(H)] += np.r_[1e-9 * max(H[0, 0], 1e-9), np.ones(len(H) - 1)]
        return H

    def rows(self, observations: Observations) -> Floats:
        """Whitened columns (V, m, p) of poses not measured yet, visited as the others were on average.

        Views weigh each by its own pixels.
        """
        if self.by_views is not None:
            observations = replace(observations, pose_weight=self.by_views.weights(observations))
        source = self.problem.settings.source
        linear = source.simulate_measurements(observations, self.problem.values).linear(self.problem.values)
        noise = np.mean(self.problem.settings.noise.visit[self.problem.settings.used], axis=0)
        L = np.linalg.inv(np.linalg.cholesky(noise + 1e-18 * np.eye(len(noise))))
        return self.columns(L @ linear.G, lambda k: L @ linear.W[..., k])


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


def _order_proposal_poses(question: _Question, proposal: Proposal, needs: frozenset[str]) -> Proposal:
    """The same poses in an order with short moves, with what is known after each, and only the conditions that matter."""
    rows = proposal.rows
    robot = question.problem.settings.source.model.robot
    rows = rows.select(driving_order(rows.q, joint_ranges(robot)))
    H, after = question.information(), []
    for X in question.rows(rows):
        H = H + X.T @ X
        after.append(1.0 / float(np.linalg.inv(H)[0, 0]))
    if "direction" not in needs:
        rows = replace(rows, direction=None)
    loads = rows.payload_kg is not None and len(np.unique(rows.payload_kg)) > 1
    if not (needs & {"moments", "payload_kg"}) and not loads:
        rows = replace(rows, payload_kg=None)
    return replace(proposal, rows=rows, after=tuple(after))


def _pool(rows: Observations, region: Region, needs: frozenset[str], rng: np.random.Generator) -> Observations:
    """Random poses in the region, under the loads that were used before, from either side where that matters."""
    q = region.draw(POOL, rng)
    loads = np.zeros(1) if rows.payload_kg is None else np.unique(rows.payload_kg)
    if not needs & {"moments", "payload_kg"}:
        loads = loads[:1]
    made = _conditions(rows, q, rng.choice(loads, POOL))
    if rows.direction is None:
        return made
    return replace(made, direction=rng.choice([-1.0, 1.0], q.shape))


def _changes(
    rows: Observations, source: Source, needs: frozenset[str], rng: np.random.Generator
) -> list[tuple[str, Observations]]:
    """Old poses under other conditions that the effects feel: another load, side, temperature, time."""
    first = np.unique(rows.pose_groups(), return_index=True)[1]
    index = np.sort(rng.permutation(first)[:POOL])
    q = rows.q[index]
    direction = None if rows.direction is None else rows.direction[index]
    load = np.zeros(len(q)) if rows.payload_kg is None else rows.payload_kg[index]
    same = replace(_conditions(rows, q, load), direction=direction)
    out = []
    if needs & {"moments", "payload_kg"}:
        other = _other_load(load, source)
        words = f"repeat these poses with {', '.join(f'{v:.3g} kg' for v in np.unique(other))}"
        out.append((words, replace(_conditions(rows, q, other), direction=direction)))
    if "direction" in needs and direction is not None:
        out.append(("repeat these poses approached from the other side", replace(same, direction=-direction)))
    if "temperature_c" in needs and rows.temperature_c is not None:
        warm = float(rows.temperature_c.max()) + WARMER_K
        words = f"repeat these poses at {warm:.0f} degrees"
        out.append((words, replace(same, temperature_c=np.full(len(q), warm))))
    if "t" in needs and rows.t is not None:
        late = float(rows.t.max() + max(np.ptp(rows.t), LATER_S))
        out.append(
            ("repeat these poses later, as long after as the campaign took", replace(same, t=np.full(len(q), late)))
        )
    return out


def _other_load(load: Floats, source: Source) -> Floats:
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
        q=q,
        payload_kg=load,
        temperature_c=mean(rows.temperature_c),
        t=mean(rows.t),
        base_tilt_x=mean(rows.base_tilt_x),
        base_tilt_y=mean(rows.base_tilt_y),
        session=None if rows.session is None else np.full(len(q), rows.session[-1]),
        qd=None if rows.qd is None else np.zeros_like(q),
        qdd=None if rows.qdd is None else np.zeros_like(q),
        payload_com=_centres(rows, load),
        direction=None if rows.direction is None else np.zeros_like(q),
    )


def _centres(rows: Observations, load: Floats) -> Floats | None:
    """Where each load hangs: as in the rows that carried it; a load that none carried where the mean of all was."""
    if rows.payload_com is None or rows.payload_kg is None:
        return None
    out = np.tile(rows.payload_com.mean(axis=0), (len(load), 1))
    for value in np.unique(load):
        carried = rows.payload_kg == value
        if carried.any():
            out[load == value] = rows.payload_com[carried].mean(axis=0)
    return out
