"""Campaigns of a simulated Katana for the gap finder's own tests; the blind generator is the judge, this is the bench."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Robot
from kilter_core.effects import make_effect
from kilter_core.model import RobotModel
from kilter_core.observations import Observations

MARKERS = np.array([[0.03, 0.0, 0.0], [-0.02, 0.03, 0.01], [-0.02, -0.03, -0.01]])

Hidden = tuple[str, tuple[int, ...] | None, tuple[float, ...]]


def katana() -> Robot:
    """The arm of the thesis, chapter 5."""
    return robot_from_document(preset_document("katana450-chapter5"))


def campaign(
    robot: Robot,
    hidden: Sequence[Hidden] = (),
    *,
    poses: int = 70,
    revisits: int = 20,
    noise_m: float = 2e-5,
    seed: int = 0,
    one_sided: bool = False,
    loads: tuple[float, ...] = (0.0, 1.0),
    orders: tuple[int, ...] = (3,),
    measured: str = "position",
    arm: int | None = None,
) -> Observations:
    """Random poses, the first ``revisits`` of them three times, with ``hidden`` effects (id, joints from 0, values).

    ``measured`` is "position", "pose" (orientation too) or "markers" (three of them, one in thirty unseen). Campaigns of
    the same ``arm`` have the same geometry but for base and tool; without one every ``seed`` is an arm of its own.
    """
    rng = np.random.default_rng(seed)
    low, high = np.clip(robot.limits, -2.9, 2.9).T
    pose = np.concatenate([np.arange(poses), np.tile(np.arange(revisits), 2)])
    q = rng.uniform(low, high, (poses, robot.n_joints))[pose]
    side = np.ones_like(q) if one_sided else rng.choice([-1.0, 1.0], (poses, robot.n_joints))[pose]
    rows = Observations(
        q=q, direction=side, payload_kg=rng.choice(loads, poses)[pose], pose_id=pose, position=np.zeros((len(q), 3)),
        temperature_c=20.0 + 5.0 * rng.random(poses)[pose], t=30.0 * rng.permutation(len(q)),
    )  # fmt: skip
    made = [make_effect(i, j, **({"orders": orders} if i == "unknown_joint_curve" else {})) for i, j, _ in hidden]
    model = RobotModel(robot, tuple(effect.configure_for_robot(robot, rows) for effect in made))
    values = model.values0()
    made_by = rng if arm is None else np.random.default_rng([arm, 1])
    for k, p in enumerate(model.parameters[: model.n_geometric]):
        of_setup = k < 6 or k >= model.n_geometric - 6
        values[k] += (rng if of_setup else made_by).normal() * (3e-4 if p.unit == "m" else 1e-3)
    values[model.n_geometric :] = [v for _, _, amounts in hidden for v in amounts]
    exact = model.predict(rows, values)
    position = exact.position + noise_m * rng.standard_normal((len(q), 3))
    if measured == "position":
        return Observations(**{**rows._present(), "position": position})
    if measured == "pose":
        turns = Rotation.from_rotvec(noise_m / 0.2 * rng.standard_normal((len(q), 3))).as_matrix()
        return Observations(**{**rows._present(), "position": position, "rotation": exact.rotation @ turns})
    markers = exact.position[:, None] + np.einsum("nij,mj->nmi", exact.rotation, MARKERS)
    markers += noise_m * rng.standard_normal(markers.shape)
    markers[rng.random(markers.shape[:2]) < 1 / 30] = np.nan
    return Observations(**{k: v for k, v in rows._present().items() if k != "position"}, markers=markers)
