"""A force sensor at the wrist: readings that Pinocchio and MuJoCo make of a body, with bias, noise and a turned sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.motion import WristReading, read_wrist
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import ur_like
from tests.core.truth import Arm, Floats

TOOL = pin.SE3(pin.exp3(np.array([0.2, -0.3, 0.4])), np.array([0.01, -0.02, 0.09]))
ORIGIN = np.array([0.0, 0.0, 0.02])  # of the sensor, at the flange
MOUNTING = np.array([0.05, -0.03, 0.8])
BIAS = np.array([4.0, -7.0, 12.0, 0.3, -0.2, 0.1])
NOISE = np.repeat([0.3, 0.01], 3)
MASS, CENTRE, INERTIA = 1.7, np.array([0.02, -0.03, 0.05]), np.diag([0.009, 0.008, 0.004])  # in the tool frame
DRAWS = 20


@dataclass
class Wrist:
    """An arm with a sensor at its flange and a body behind that."""

    seed: int
    mounting: Floats

    def __post_init__(self) -> None:
        self.arm: Arm = replace(ur_like(np.random.default_rng(1)), tool=TOOL)
        self.rng = np.random.default_rng(self.seed)
        last = max(k for k, step in enumerate(self.arm.steps) if step.joint is not None)
        flange = pin.SE3.Identity()
        for step in self.arm.steps[last + 1 :]:
            flange = flange * step.motion()
        self.sensor = flange * pin.SE3(pin.exp3(self.mounting), ORIGIN)
        bare = replace(self.arm, bodies=())
        self.model, _ = bare.pinocchio()
        tool = flange * TOOL
        body = pin.Inertia(MASS, tool.act(CENTRE), tool.rotation @ INERTIA @ tool.rotation.T)
        self.model.appendBodyToJoint(self.model.njoints - 1, body, pin.SE3.Identity())

    def feel(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """What the body does to the sensor, (N, 6)."""
        data, out = self.model.createData(), np.empty((len(q), 6))
        for k, row in enumerate(zip(self.arm.motors(q), self.arm.rates(qd), self.arm.rates(qdd), strict=True)):
            pin.rnea(self.model, data, *row)
            out[k] = -self.sensor.actInv(data.f[self.model.njoints - 1]).vector
        return out

    def read(self, wrench: Floats) -> Floats:
        return wrench + BIAS + self.rng.normal(0.0, NOISE, wrench.shape)

    def poses(self, count: int, spread: float = 2.4) -> Observations:
        q = self.rng.uniform(-spread, spread, (count, 6))
        return Observations(q=q, wrench=self.read(self.feel(q, 0.0 * q, 0.0 * q)))

    def log(self, seconds: float = 40.0, push: float = 0.0) -> Observations:
        t = np.arange(0.0, seconds, 0.01)
        q, qd, qdd = (np.zeros((len(t), 6)) for _ in range(3))
        for _ in range(4):
            w, a, p = self.rng.uniform(0.5, 4.0, 6), self.rng.uniform(0.05, 0.25, 6), self.rng.uniform(0.0, 6.0, 6)
            angle = np.outer(t, w) + p
            q, qd, qdd = q + a * np.sin(angle), qd + a * w * np.cos(angle), qdd - a * w**2 * np.sin(angle)
        q[:, 3:] += np.outer(np.sin(0.2 * t), [1.0, 1.2, 1.4])
        qd[:, 3:] += np.outer(0.2 * np.cos(0.2 * t), [1.0, 1.2, 1.4])
        qdd[:, 3:] -= np.outer(0.04 * np.sin(0.2 * t), [1.0, 1.2, 1.4])
        wrench = self.feel(q, qd, qdd)
        wrench[(t > 20.0) & (t < 23.0), :3] += push * np.array([0.6, 0.0, 0.8])
        return Observations(q=q, t=t, wrench=self.read(wrench))

    def find(self, rows: Observations) -> WristReading:
        return read_wrist(robot_from_document(self.arm.document()), rows, ORIGIN)


def deviations(found: WristReading, mounting: Floats) -> Floats:
    """How far each number is off, in its standard deviations."""
    body = found.body
    turn = pin.log3(pin.exp3(mounting).T @ pin.exp3(found.mounting))
    off = [found.bias - BIAS, [body.mass - MASS], body.centre - CENTRE, turn]
    sigma = [found.bias_sigma, [body.mass_sigma], body.centre_sigma, found.mounting_sigma]
    if np.isfinite(body.inertia).all():
        upper = np.triu_indices(3)
        off.append((body.inertia - INERTIA)[upper])
        sigma.append(body.inertia_sigma[upper])
    return np.concatenate(off) / np.concatenate(sigma)


@pytest.mark.parametrize("moving", [False, True])
def test_what_hangs_on_a_sensor_is_right_and_its_intervals_hold(moving: bool) -> None:
    apart = []
    for seed in range(DRAWS):
        wrist = Wrist(seed, MOUNTING)
        found = wrist.find(wrist.log() if moving else wrist.poses(30))
        assert abs(found.body.mass - MASS) < 0.02 * MASS
        assert np.linalg.norm(found.body.centre - CENTRE) < 0.005
        assert np.isfinite(found.body.inertia).all() == moving
        assert np.sqrt(np.mean(found.free[:, :3] ** 2)) < 1.2 * NOISE[0]
        apart.append(deviations(found, MOUNTING))
    inside = np.mean(np.abs(np.array(apart)) < 1.96)
    assert 0.92 < inside < 0.985


def test_a_contact_is_left_out_and_felt() -> None:
    wrist = Wrist(3, MOUNTING)
    found = wrist.find(wrist.log(push=25.0))
    assert np.abs(deviations(found, MOUNTING)).max() < 4.0
    pushed = (found.at > 20.4) & (found.at < 22.6)
    assert found.touched[pushed].all()
    assert not found.touched[(found.at < 19.0) | (found.at > 24.0)].any()
    assert np.abs(found.free[pushed, :3] - [15.0, 0.0, 20.0]).max() < 1.0


def test_axes_of_the_sensor_are_believed_where_gravity_turns_in_a_plane_only() -> None:
    wrist = Wrist(4, np.zeros(3))
    rows = wrist.poses(500)
    flange = wrist.arm.poses(rows.q)[1] @ TOOL.rotation.T
    found = wrist.find(rows.select(np.abs(flange[:, 2, 0]) < 0.1))  # little gravity along its x
    assert np.isnan(found.mounting_sigma).all()
    assert not found.mounting.any()
    assert abs(found.body.mass - MASS) < 0.02 * MASS


def test_readings_that_cannot_be_told_are_refused_by_name() -> None:
    wrist = Wrist(5, MOUNTING)
    rows = wrist.poses(30)
    assert rows.wrench is not None
    R = wrist.arm.poses(rows.q)[1] @ TOOL.rotation.T @ pin.exp3(MOUNTING)
    in_base = np.concatenate([np.einsum("nij,nj->ni", R, rows.wrench[:, k : k + 3]) for k in (0, 3)], axis=1)
    still = replace(rows, q=np.tile(rows.q[:1], (30, 1)))
    for bad, code in (
        (replace(rows, wrench=-rows.wrench), "wrench_sign"),
        (replace(rows, wrench=in_base), "wrench_unexplained"),
        (replace(rows, wrench=rows.wrench[::-1]), "wrench_unexplained"),
        (replace(rows, wrench=rows.wrench[:, [1, 0, 2, 4, 3, 5]]), "wrench_sign"),
        (still, "wrench_poses"),
        (rows.select(slice(0, 4)), "wrench_poses"),
        (replace(rows, wrench=np.tile(BIAS, (30, 1))), "wrench_missing"),
        (replace(rows, wrench=None), "wrench_missing"),
    ):
        with pytest.raises(ObservationError) as refused:
            wrist.find(bad)
        assert refused.value.code == code


def test_a_sensor_of_mujoco_says_the_same() -> None:
    wrist = Wrist(6, MOUNTING)
    rows = wrist.log(20.0)
    R, tool = pin.exp3(MOUNTING), TOOL
    quat = pin.Quaternion(R)
    spec = mujoco.MjSpec()
    spec.option.gravity = (0.0, 0.0, -9.80665)
    body = spec.worldbody
    for step in wrist.arm.steps:
        axis = np.eye(3)["xyz".index(step.axis[1])]
        if step.joint is not None:
            body = body.add_body()
            body.mass, body.inertia, body.explicitinertial = 1e-3, np.full(3, 1e-6), True
            assert step.axis[0] == "r"
            body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
            continue
        pose = step.motion()
        at = pin.Quaternion(pose.rotation)
        body = body.add_body(pos=pose.translation, quat=[at.w, at.x, at.y, at.z])
    place = tool.act(CENTRE)
    inertia = tool.rotation @ INERTIA @ tool.rotation.T
    carried = body.add_body(name="carried")
    carried.mass, carried.ipos, carried.explicitinertial = MASS, place, True
    carried.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    carried.add_site(name="sensor", pos=ORIGIN, quat=[quat.w, quat.x, quat.y, quat.z])
    for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="sensor")
    model = spec.compile()
    data = mujoco.MjData(model)
    wrench = np.empty((len(rows.q), 6))
    qd = np.gradient(wrist.arm.motors(rows.q), 0.01, axis=0)
    for k, row in enumerate(zip(wrist.arm.motors(rows.q), qd, np.gradient(qd, 0.01, axis=0), strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        wrench[k] = -data.sensordata
    found = wrist.find(replace(rows, wrench=wrist.read(wrench)))
    assert abs(found.body.mass - MASS) < 0.02 * MASS
    assert np.linalg.norm(found.body.centre - CENTRE) < 0.005
    assert np.abs(deviations(found, MOUNTING)).max() < 4.5
