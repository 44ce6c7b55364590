"""Circle and straight line on a Katana that Pinocchio bends: not one line of the core makes its errors.

In kind with the thesis's figure 5.12 (circle: 0.653 mm before, 0.312 geometry only, 0.211 with stiffness, 0.132 in full):
identify from 118 measured poses, correct the path as the stream does, and see where the bent arm goes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.twin import thesis_katana
from tests.core.campaigns import joints, table_errors
from tests.core.effects.by_hand import inserted
from tests.core.truth import Arm, Body, Step, small_pose, some_arm, ur10

PRESET = "katana450-chapter5"
NOISE_M = 2e-5
DAMPED, RESIDUAL = 0x0800, 0x1000
FREE: Any = {"largest_rad": 0.3, "largest_m": 0.1, "farthest_m": 0.1}


def katana() -> Arm:
    """The preset's document, read by hand."""
    document: Mapping[str, Any] = preset_document(PRESET)
    names = [joint["name"] for joint in document["joints"]]
    steps = tuple(
        Step(
            element["axis"].lower(),
            (math.radians if element["axis"][0] == "R" else (lambda mm: mm * 1e-3))(element.get("value", 0.0)),
            names.index(element["joint"]) if "joint" in element else None,
            name=element.get("name") or f"theta_offset_{names.index(element['joint']) + 1}",
        )
        for element in document["elements"]
    )
    base, tool = (np.array([document[k][f"{x}_mm"] for x in "xyz"]) * 1e-3 for k in ("base", "tool"))
    bodies = tuple(
        Body(j, link["mass_kg"], np.array(link["com_mm"]) * 1e-3) for j, link in enumerate(document["links"])
    )
    return Arm(steps, 5, pin.SE3(np.eye(3), base), pin.SE3(np.eye(3), tool), bodies)


@dataclass(frozen=True)
class Bent:
    """The arm with errors in its geometry, joints that lean and turn by their play, and give way."""

    ideal: Arm
    real: Arm
    clearance: np.ndarray
    play: np.ndarray
    compliance: np.ndarray

    def points(self, q: np.ndarray) -> np.ndarray:
        """Tool points (N, 3)."""
        return np.array([self._pose(row).translation for row in q])

    def _pose(self, row: np.ndarray) -> Any:
        torques, wrenches, _ = self.ideal.reactions(row)
        load, turn = -wrenches, np.zeros(5)
        twists = {}
        for j in range(5):
            mx, my, mz = load[j, 3:]
            across = 0.5 * math.pi * abs(mx) / (abs(mx) + abs(my)) if abs(mx) + abs(my) > 1e-9 else 0.0
            t = math.tan(self.clearance[j])
            lean = [t * math.sin(across) * np.sign(mx), t * math.cos(across) * np.sign(my)]
            if abs(mx) + abs(my) <= 1e-9:
                lean = [0.0, 0.0]
            twists[j] = np.array([0.0, 0.0, 0.0, *(x / math.sqrt(1.0 + x * x) for x in lean), 0.0])
            turn[j] = np.sign(mz) * self.play[j] if abs(mz) > 1e-9 else 0.0
        return inserted(self.real, row - self.compliance * torques + turn, twists)


def bent() -> Bent:
    arm, sizes = katana(), thesis_katana().errors  # the thesis's numbers
    of = {stem: np.array([sizes[f"{stem}_{j}"] for j in range(1, 6)]) for stem in STEMS}
    geometry = {name: value for name, value in sizes.items() if name.rpartition("_")[0] not in STEMS}
    known = {step.name for step in arm.steps}
    assert len(set(geometry) & known) > 8
    return Bent(arm, arm.moved({k: v for k, v in geometry.items() if k in known}), *of.values())


STEMS = ("clearance", "backlash_load", "compliance")


def along(points: np.ndarray, arm: Arm, start: Sequence[float]) -> np.ndarray:
    """Joints (N, 5) that take the ideal arm along points (N, 3), each found from the one before."""
    q, out = np.array(start, dtype=float), []
    for point in points:
        for _ in range(30):
            miss = point - arm.poses(q[None])[0][0]
            if np.linalg.norm(miss) < 1e-10:
                break
            q = q + np.linalg.pinv(arm.joint_jacobians(q[None])[0, :3]) @ miss
        else:
            raise AssertionError("out of reach")
        out.append(q)
    return np.array(out)


START = (0.4, 0.9, -0.8, -0.9, 0.3)


@pytest.fixture(scope="module")
def twin() -> Bent:
    return bent()


@pytest.fixture(scope="module")
def calibrations(twin: Bent) -> dict[str, Calibration]:
    """What 118 measured poses tell: the geometry alone, with stiffness, and in full."""
    rng = np.random.default_rng(7)
    robot = robot_from_document(preset_document(PRESET))
    lower, upper = np.clip(robot.limits, -1.6, 1.6).T
    q = rng.uniform(lower, upper, (118, 5))
    seen = Observations(q, position=twin.points(q) + rng.normal(0.0, NOISE_M, (118, 3)))
    fixed = {"base": "fixed", "tool": "fixed"}
    options = {
        "geometry": IdentifyOptions.from_document({"level": 2, **fixed}),
        "stiffness": IdentifyOptions.from_document({"level": 3, "effects": ["axial_compliance"], **fixed}),
        "full": IdentifyOptions.from_document({"level": 3, **fixed}),
    }
    return {name: identify(robot, seen, options=given).calibration for name, given in options.items()}


def circle() -> np.ndarray:
    centre = katana().poses(np.array([START]))[0][0]
    phase = np.linspace(0.0, 2.0 * math.pi, 240)
    return centre + 0.05 * np.column_stack([np.cos(phase) - 1.0, np.sin(phase), 0.2 * np.sin(phase)])


def line() -> np.ndarray:
    begin = katana().poses(np.array([START]))[0][0]
    return begin + np.linspace(0.0, 1.0, 160)[:, None] * np.array([-0.05, 0.10, 0.03])


@pytest.mark.parametrize("path", [circle, line], ids=["circle", "line"])
def test_each_stage_brings_the_bent_arm_nearer_to_its_path(
    path: Any, twin: Bent, calibrations: dict[str, Calibration], record_property: Any
) -> None:
    wanted = path()
    q = along(wanted, twin.ideal, START)
    errors = {"before": np.linalg.norm(twin.points(q) - wanted, axis=1)}
    for name, calibration in calibrations.items():
        # Wanted is where the ideal arm would be; the path takes 24 s, as a pen on paper does.
        track = Track(compile_program(calibration, CorrectionOptions()), settled=True)
        done, out, _, _ = track.follow(q, 1, np.full(len(q), 0.1))
        assert done == len(q)
        errors[name] = np.linalg.norm(twin.points(out) - wanted, axis=1)
    mean = {name: float(np.mean(error)) * 1e3 for name, error in errors.items()}
    record_property("mean_mm", mean)
    print(mean)
    assert mean["before"] > 0.3
    assert mean["geometry"] < 0.9 * mean["before"]
    assert mean["stiffness"] < 0.6 * mean["geometry"]
    assert mean["full"] < 0.2 * mean["stiffness"]
    assert mean["full"] < 0.04


def arm_with_errors(n: int, seed: int) -> tuple[Arm, Arm, Calibration, np.ndarray]:
    """A random arm, itself with errors, a calibration that knows them, and joints away from its singular postures."""
    rng = np.random.default_rng(seed)
    nominal = some_arm(rng, n)
    errors = table_errors(nominal, rng, 2e-4, 4e-4)
    model = RobotModel(robot_from_document(nominal.document()))
    calibration = Calibration(model, model.values0() + [errors.get(name, 0.0) for name in model.names])
    q = joints(nominal, 800, rng)
    smallest = np.linalg.svd(nominal.joint_jacobians(q)[:, : min(n, 6)], compute_uv=False)[:, -1]
    return nominal, nominal.moved(errors), calibration, q[smallest > 0.05][:40]


def misses(real: Arm, ideal: Arm, corrected: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance of the points, angle of the tools and angle of their z axes, each (N,)."""
    (p, R), (wanted, W) = real.poses(corrected), ideal.poses(q)
    turns = np.array([np.linalg.norm(pin.log3(a.T @ b)) for a, b in zip(R, W, strict=True)])
    leaning = np.linalg.norm(np.cross(R[:, :, 2], W[:, :, 2]), axis=1)
    return np.linalg.norm(p - wanted, axis=1), turns, leaning


@pytest.mark.parametrize("n", [6, 7])
@pytest.mark.parametrize("weight_m", [0.05, 0.2, 1.0])
def test_six_and_seven_joints_hold_the_whole_pose(n: int, weight_m: float) -> None:
    ideal, real, calibration, q = arm_with_errors(n, 40 + n)
    assert len(q) > 10
    program = compile_program(calibration, CorrectionOptions(task="pose", orientation_weight_m=weight_m, **FREE))
    assert program.held_rows == ("x", "y", "z", "rx", "ry", "rz")
    result = program.correct_rows(q)
    assert not result.status.any()
    points, turns, _ = misses(real, ideal, result.q, q)
    assert points.max() < 1e-6
    assert turns.max() < 1e-6 / weight_m + 1e-6


def test_the_weight_says_what_gives_way_where_not_all_can_be_held() -> None:
    ideal, real, calibration, q = arm_with_errors(6, 46)
    q = np.tile(q[:1], (30, 1))
    q[:, 1] += np.linspace(-0.5, 0.5, 30)
    found = {}
    for weight_m in (0.01, 10.0):
        # A limit that nothing reaches the pose with damps it, so the weights show.
        options = CorrectionOptions(task="pose", orientation_weight_m=weight_m, largest_rad=1e-3, weak_m=10.0)
        points, turns, _ = misses(real, ideal, compile_program(calibration, options).correct_rows(q).q, q)
        found[weight_m] = (np.mean(points), np.mean(turns))
    assert found[0.01][0] < found[10.0][0]
    assert found[0.01][1] > found[10.0][1]


def test_five_joints_hold_the_point_or_the_axis_and_say_so() -> None:
    ideal, real, calibration, q = arm_with_errors(5, 45)
    point = compile_program(calibration, CorrectionOptions(**FREE))
    assert point.held_rows == ("x", "y", "z")
    points, turns, _ = misses(real, ideal, point.correct_rows(q).q, q)
    assert points.max() < 1e-6
    assert turns.max() > 1e-4
    axis = compile_program(calibration, CorrectionOptions(task="axis", **FREE))
    assert axis.held_rows == ("x", "y", "z", "rx", "ry")
    result = axis.correct_rows(q)
    good = (result.flags & (DAMPED | RESIDUAL)) == 0
    assert good.mean() > 0.5
    points, turns, leaning = misses(real, ideal, result.q, q)
    assert points[good].max() < 1e-6
    assert leaning[good].max() < 1e-5
    assert turns.max() > 1e-4


def test_near_a_singular_posture_the_true_arm_is_not_made_worse() -> None:
    rng = np.random.default_rng(4)
    ideal = ur10(tool=small_pose(rng, 0.05, 0.1))
    errors = table_errors(ideal, rng)
    model = RobotModel(robot_from_document(ideal.document()))
    calibration = Calibration(model, model.values0() + [errors.get(name, 0.0) for name in model.names])
    q = np.tile([0.3, -1.0, 1.2, -0.5, 0.0, 0.1], (401, 1))
    q[:, 4] = np.linspace(-0.02, 0.02, 401)  # the wrist of a UR is singular at zero
    result = compile_program(calibration).correct_rows(q)
    near, good = np.abs(q[:, 4]) < 1e-3, result.status == 0
    assert (result.flags[near] & DAMPED).all()
    assert np.abs(result.q[good] - q[good]).max() <= CorrectionOptions().largest_rad
    before, _, _ = misses(ideal.moved(errors), ideal, q[good], q[good])
    after, _, _ = misses(ideal.moved(errors), ideal, result.q[good], q[good])
    assert good.mean() > 0.5
    assert (after < 0.5 * before).all()
    clear = good & ((result.flags & (DAMPED | RESIDUAL)) == 0)
    assert misses(ideal.moved(errors), ideal, result.q[clear], q[clear])[0].max(initial=0.0) < 1e-6


@pytest.mark.parametrize("n", [5, 6, 7])
def test_what_is_said_to_be_left_is_left(n: int) -> None:
    ideal, real, calibration, q = arm_with_errors(n, 50 + n)
    q = np.vstack([q, joints(ideal, 60, np.random.default_rng(n))])  # near singular postures too
    result = compile_program(calibration, CorrectionOptions(farthest_m=0.1)).correct_rows(q)
    check_left(real, ideal, result.q, q, result.left, result.left_rad)


def check_left(real: Arm, ideal: Arm, q: np.ndarray, at: np.ndarray, left: np.ndarray, left_rad: np.ndarray) -> None:
    """Hold ``left`` (N, 3), in the axes of the base, and ``left_rad`` (N,) against where the arms are."""
    (p, R), (wanted, W) = real.poses(q), ideal.poses(at)
    np.testing.assert_allclose(left, (p - wanted) @ ideal.base.rotation, rtol=0.0, atol=2e-8)
    turns = np.array([np.linalg.norm(pin.log3(a.T @ b)) for a, b in zip(R, W, strict=True)])
    np.testing.assert_allclose(left_rad, turns, rtol=0.0, atol=1e-5)


def test_what_is_left_while_a_stream_ramps_in_is_said() -> None:
    ideal, real, calibration, q = arm_with_errors(6, 46)
    q = np.tile(q[0], (600, 1))
    track = Track(compile_program(calibration, CorrectionOptions(farthest_m=0.1)))
    done, out, info, _ = track.follow(q, 1, np.full(len(q), 0.002))
    assert done == len(q)
    left = info[:, layout.LEFT : layout.LEFT + 3]
    check_left(real, ideal, out, q, left, info[:, layout.LEFT_TURN])
    np.testing.assert_allclose(left[0], info[0, layout.REMOVED : layout.REMOVED + 3] * -1.0, atol=1e-6)
    assert np.linalg.norm(left[-1]) < 1e-8
