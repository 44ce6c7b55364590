"""An exported model of MuJoCo, left to settle: the tool is where Kilter predicts it, effect by effect."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import kilter.twin
from kilter_client.errors import UsageError
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects import EFFECTS, make_effect
from kilter_core.errors import RobotError
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.twin import Twin
from kilter_service.contract.fits import Errors, Metrics, StageErrors
from kilter_service.robots.exporters.registry import Exported, export
from tests.service.exporters.test_exporters import exportable

Floats = NDArray[np.float64]

GEOMETRY = {
    "theta_offset_2": 1e-3, "a_2": 3e-4, "alpha_4": 2e-3, "base_ry": 1e-3, "base_x": 1e-3, "tool_y": 1e-3,
    "theta_offset_5": -2e-3,
}  # fmt: skip
SAG = dict(zip((f"compliance_{j}" for j in range(1, 7)), (2e-6, 2e-6, 3e-6, 1e-5, 1e-5, 1e-5), strict=True))
BACKLASH = {"backlash_load_1": 0.0, "backlash_load_2": 5e-4, "backlash_load_3": 4e-4}
WINDUP = dict(zip((f"windup_{j}" for j in range(1, 7)), (-2e-4, -3e-4, -3e-4, -5e-4, -5e-4, -5e-4), strict=True))
MOUNT = {"base_compliance_x": 2e-6, "base_compliance_y": 3e-6}
EVERYTHING = GEOMETRY | SAG | BACKLASH | WINDUP | MOUNT
ALL = ("axial_compliance", "backlash_load", "friction_windup", "base_compliance")
LOADED_NM = 3.0  # on joints with backlash: where less holds a gear on its flank, it takes long to get there
CLOSE_UM, CLOSE_WITH_BACKLASH_UM = 10.0, 20.0

# What elements are, with the parameters that a joint may have, and the size of what the step adds.
IN_THE_MODEL: Mapping[str, Mapping[str, float]] = {
    "axial_compliance": SAG,
    "backlash_load": BACKLASH,
    "friction_windup": WINDUP,
    "backlash": {"backlash_2": -6e-4, "backlash_3": -4e-4},
    "base_compliance": MOUNT,
    "load_error": {},
}
BY_THE_STEP = {
    "clearance_tilt": 3e-4, "radial_compliance": 2e-6, "eccentricity": 5e-4, "second_harmonic": 3e-4, "gear_error": 1e-4,
    "encoder_scale": 5e-4, "joint_coupling": 5e-4, "gravity_spring": 3e-4, "link_bending": 1e-5, "link_torsion": 1e-4,
    "direction_compliance": -1e-6, "reading_tilt": 1e-5, "unknown_joint_curve": 3e-4,
}  # fmt: skip
OF_SLIDES = {"straightness", "guide_rotation", "telescope_bending"}
OF_LOADS = {"payload_error", "tool_sag"}  # what the robot carries by itself


def twin(
    effects: Iterable[str], values: Mapping[str, float], preset: str = "ur10", **changes: Any
) -> tuple[Exported, Calibration]:
    document = preset_document(preset) | changes
    calibration = Twin(robot_from_document(document), values, tuple(make_effect(e) for e in effects)).truth
    return export("mjcf", exportable(document, calibration)), calibration


def settled(
    model: mujoco.MjModel,
    q: Floats,
    side: float,
    payload_kg: float,
    step_s: float,
    every: int = 0,
    seconds: float = 2.0,
) -> tuple[Floats, mujoco.MjData]:
    """Tool point (3,) m after every joint came to ``q (n,)`` from one side; ``every`` so many steps Kilter's own is taken."""
    data, reach = mujoco.MjData(model), 0.02
    model.opt.timestep = step_s
    model.body("payload").mass = payload_kg
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetData(model, data)
    start = q - side * reach
    data.qpos[[model.jnt_qposadr[j] for j in model.actuator_trnid[:, 0]]] = data.ctrl[:] = start
    steps = round(seconds / step_s)
    for k in range(steps):
        data.ctrl[:] = start + side * reach * min(1.0, 2.0 * k / steps)
        if every and k % every == 0:
            kilter.twin.apply(model, data)
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    return data.site("tool").xpos.copy(), data


def poses(calibration: Calibration, count: int, seed: int = 1) -> Floats:
    """Joints (count, n) at which the joints with backlash are loaded, one by one."""
    playing = [int(name.rpartition("_")[2]) - 1 for name, v in zip(calibration.names, calibration.values, strict=True)
               if name.startswith("backlash_load_") and v > 0.0]  # fmt: skip
    q = np.random.default_rng(seed).uniform(-1.5, 1.5, (20 * count, calibration.robot.n_joints))
    load = np.abs(at_the_readings(calibration).model.batch(Observations(q)).axial[:, playing])
    return q[np.all(load > LOADED_NM, axis=1)][:count]


def at_the_readings(calibration: Calibration) -> Calibration:
    """The same version with loads as those of earlier releases have them."""
    chain = calibration.model.load_chain
    assert chain is not None
    model = dataclasses.replace(calibration.model, load_chain=dataclasses.replace(chain, effects=None))
    return dataclasses.replace(calibration, model=model)


def farthest_um(
    found: tuple[Exported, Calibration], count: int, step_s: float = 2e-3, every: int = 0,
    loads: tuple[float, ...] = (0.0, 4.0), **times: float,
) -> float:  # fmt: skip
    """Largest distance between the settled tool and its prediction, from both sides and with each payload."""
    exported, calibration = found
    model, apart = mujoco.MjModel.from_xml_string(str(exported.text)), []
    for q in poses(calibration, count):
        for payload_kg in loads:
            for side in (-1.0, 1.0):
                rows = Observations(q[None], direction=np.full((1, len(q)), side), payload_kg=np.array([payload_kg]))
                told = calibration.predict(rows).position
                apart.append(np.linalg.norm(settled(model, q, side, payload_kg, step_s, every, **times)[0] - told[0]))
    assert len(apart) == 2 * len(loads) * count
    return float(np.max(apart) * 1e6)


def test_the_bodies_are_those_of_the_version() -> None:
    assert farthest_um(twin((), GEOMETRY), 3) < CLOSE_UM / 10.0


def test_how_far_a_soft_base_tilts_stands_in_the_notes() -> None:
    """A prediction leaves its tilt out of the loads; the twin settles within what is said, and near it when stretched out."""
    exported, _ = twin(["base_compliance"], MOUNT)
    said = next(line for line in exported.notes if "soft base tilts" in line)
    most = float(said.split("up to ")[1].split(" deg")[0])
    model = mujoco.MjModel.from_xml_string(str(exported.text))
    stretched = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    data = settled(model, stretched, 1.0, 0.0, 2e-3)[1]
    tilt = np.degrees(np.hypot(*(data.joint(f"base_{axis}").qpos[0] for axis in "xy")))
    assert 0.5 * most < tilt < 1.1 * most
    assert not any("soft base" in line for line in twin(["axial_compliance"], SAG)[0].notes)


@pytest.mark.parametrize("effect", sorted(IN_THE_MODEL))
def test_elements_hold_the_effect(effect: str) -> None:
    """Beside a wind-up or backlash there is a sag, as there is on an arm."""
    values = GEOMETRY | SAG | dict(IN_THE_MODEL[effect])
    found = twin(dict.fromkeys(["axial_compliance", effect]), values)
    assert farthest_um(found, 4) < (CLOSE_WITH_BACKLASH_UM if effect == "backlash_load" else CLOSE_UM)
    assert f"In the model: {effect}, " in " ".join(found[0].notes)
    without = dataclasses.replace(found[1], values=_without(found[1], effect))
    if effect != "load_error":
        assert farthest_um((found[0], without), 1) > 50.0


def _without(calibration: Calibration, effect: str) -> Floats:
    values = calibration.values.copy()
    values[calibration.model.effect_slices()[effect]] = 0.0
    return values


@pytest.mark.parametrize("step_s", [1e-3, 2e-3, 5e-3])
def test_all_together_at_the_steps_that_people_take(step_s: float) -> None:
    assert farthest_um(twin(ALL, EVERYTHING), 5, step_s) < CLOSE_WITH_BACKLASH_UM


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("step_s", [1e-3, 2e-3, 5e-3])
def test_two_hundred_poses_from_both_sides_with_two_payloads(step_s: float) -> None:
    assert farthest_um(twin(("axial_compliance",), GEOMETRY | SAG), 200, step_s) < CLOSE_UM
    assert farthest_um(twin(ALL, EVERYTHING), 200, step_s) < CLOSE_WITH_BACKLASH_UM


@pytest.mark.parametrize("step_s", [2e-3, 5e-3])
def test_a_minute_later_it_is_still_there(step_s: float) -> None:
    exported, calibration = twin(ALL, EVERYTHING)
    model = mujoco.MjModel.from_xml_string(str(exported.text))
    q = poses(calibration, 1)[0]
    place, data = settled(model, q, 1.0, 4.0, step_s)
    for _ in range(round(60.0 / step_s)):
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    assert np.linalg.norm(data.site("tool").xpos - place) * 1e6 < CLOSE_UM  # what friction holds creeps
    rows = Observations(q[None], direction=np.ones((1, 6)), payload_kg=np.array([4.0]))
    assert np.linalg.norm(data.site("tool").xpos - calibration.predict(rows).position[0]) * 1e6 < CLOSE_WITH_BACKLASH_UM
    assert np.abs(data.qvel).max() < 1e-6


def test_a_joint_without_compliance_is_rigid_beside_one_that_winds_up() -> None:
    values = GEOMETRY | WINDUP | BACKLASH
    assert farthest_um(twin(("backlash_load", "friction_windup"), values), 3, 5e-3) < CLOSE_WITH_BACKLASH_UM


@cache
def stepped(effect: str) -> tuple[Exported, Calibration]:
    """An arm with all parameters of an effect, of either sign where it may have either."""
    robot = robot_from_document(preset_document("ur10"))
    own = make_effect(effect).configure_for_robot(robot)
    rng, size = np.random.default_rng(3), BY_THE_STEP[effect]
    drawn = {p.name: size * float(rng.uniform(0.3, 1.0)) for p in own.parameters(robot)}
    signs = rng.choice([-1.0, 1.0], len(drawn)) if own.signs != "positive" else np.ones(len(drawn))
    return twin((effect,), GEOMETRY | {n: v * s for (n, v), s in zip(drawn.items(), signs.tolist(), strict=True)})


@pytest.mark.parametrize("effect", sorted(BY_THE_STEP))
def test_the_step_adds_what_no_element_is(effect: str) -> None:
    found = stepped(effect)
    assert farthest_um(found, 1, 4e-3, every=8, seconds=1.0) < CLOSE_UM
    assert farthest_um(found, 1, 4e-3, every=0, seconds=1.0) > 2.0 * CLOSE_UM
    assert f"(kilter.twin.apply) only: {effect}, worth " in " ".join(found[0].notes)


def test_hardening_is_added_beside_the_compliance() -> None:
    found = twin(("axial_compliance", "hardening"), GEOMETRY | SAG | {"hardening_2": 1e-8, "hardening_3": 1e-8})
    assert farthest_um(found, 1, 4e-3, every=8, seconds=1.0) < CLOSE_UM
    assert farthest_um(found, 1, 4e-3, seconds=1.0) > 2.0 * CLOSE_UM


def test_what_pushes_instead_of_giving_way_is_added_by_the_step() -> None:
    """A joint that leads its motor, or a side that changes softly: neither friction nor a hinge with limits."""
    document = preset_document("ur10")
    soft = make_effect("backlash_load", softening_nm=20.0)
    values = GEOMETRY | {"windup_2": 3e-4, "windup_3": -2e-4, "backlash_load_2": 4e-4}
    arm = Twin(robot_from_document(document), values, (make_effect("friction_windup"), soft)).truth
    found = export("mjcf", exportable(document, arm)), arm
    model = mujoco.MjModel.from_xml_string(str(found[0].text))
    assert model.joint("elbow").frictionloss[0] > 0.0 == model.joint("shoulder_lift").frictionloss[0]
    assert farthest_um(found, 1, 4e-3, every=8) < CLOSE_UM


def test_every_effect_is_told() -> None:
    """In the model, by the step, or left out: with its size where it acts on an arm that carries nothing."""
    robot = robot_from_document(preset_document("ur10"))
    known = {
        *IN_THE_MODEL,
        *BY_THE_STEP,
        "hardening",
        "strain_wave",
        "base_step",
        "tool_step",
        "zero_step",
        "encoder_curve",
        "local_bump",
    }
    asked = {
        "settling": {"tau_s": 10.0}, "random_walk": {"knots_s": (0.0, 1.0)},
        "unknown_residual": {"centres": ((0.0,) * 6,), "length": 1.0}, "base_step": {"at_row": 2},
        "tool_step": {"at_row": 2}, "zero_step": {"at_row": 2}, "session_shift": {"sessions": (1, 2)},
        "unknown_smooth_curve": {"centres": (0.0,) * 6, "halves": (1.0,) * 6},
        "telescope_bending": {"joints": (1,)},
    }  # fmt: skip
    for name, effect in EFFECTS.items():
        if name in OF_SLIDES or effect.stage == "measurement":
            continue
        own = effect.from_options(**asked.get(name, {})).configure_for_robot(robot)
        arm = Calibration.nominal(robot, (own,))
        values = arm.values.copy()
        at = arm.model.effect_slices()[name]
        values[at] = [p.prior_sigma * 0.01 for p in own.parameters(robot)]
        told = export("mjcf", exportable(preset_document("ur10"), dataclasses.replace(arm, values=values))).notes
        said = [line for line in told if f": {name}, " in line]
        assert len(said) == 1, name
        assert (not said[0].startswith("Left out")) == (name in known | {"unknown_smooth_curve"}), said


def test_slides_sag_and_play_and_bend_out_of_line() -> None:
    elements = [
        {"axis": "Tz", "joint": "z", "name": "zero_z"}, {"axis": "Ty", "value": 120.0, "name": "y"},
        {"axis": "Rz", "joint": "turn", "name": "zero_turn"}, {"axis": "Tx", "value": 300.0, "name": "arm"},
        {"axis": "Rx", "joint": "wrist", "name": "zero_wrist", "ratio": -1},
    ]  # fmt: skip
    document: dict[str, Any] = {
        "name": "slide", "convention": "chain", "elements": elements,
        "joints": [{"name": "z", "type": "prismatic", "limits_mm": [0, 500]},
                   {"name": "turn", "limits_deg": [-170, 170]}, {"name": "wrist", "limits_deg": [-170, 170]}],
        "links": [{"mass_kg": 8.0, "com_mm": [0, 40, 0]}, {"mass_kg": 3.0, "com_mm": [120, 0, 30]},
                  {"mass_kg": 1.0, "com_mm": [20, 10, 30]}],
        "tool": {"x_mm": 30, "y_mm": 10, "z_mm": 80, "rx_deg": 0, "ry_deg": 20, "rz_deg": 0},
    }  # fmt: skip
    robot = robot_from_document(document)
    wavy = make_effect("straightness", joints=[0], centres=(0.25,), halves=(0.25,))
    crooked = {p.name: 1e-4 for p in wavy.configure_for_robot(robot).parameters(robot)}
    effects = (make_effect("axial_compliance"), make_effect("backlash_load", joints=[0, 2]), wavy)
    values = {"compliance_1": 1e-6, "compliance_3": 1e-4, "backlash_load_1": 2e-4, "backlash_load_3": 1e-3, "y": 1e-3}
    arm = Twin(robot, values | crooked, effects).truth
    model = mujoco.MjModel.from_xml_string(str(export("mjcf", exportable(document, arm)).text))
    for q in ([0.1, 0.5, -0.4], [0.4, -1.0, 0.7]):
        for side in (-1.0, 1.0):
            told = arm.predict(Observations(np.array([q]), payload_kg=np.array([2.0]))).position[0]
            found = settled(model, np.array(q), side, 2.0, 4e-3, every=8)[0]
            assert np.linalg.norm(found - told) * 1e6 < CLOSE_WITH_BACKLASH_UM


SERVO_ARM: dict[str, Any] = {
    "name": "servo", "convention": "dh",
    "joints": [{"name": f"j{k}", "limits_deg": [-110, 110]} for k in range(1, 4)],
    "rows": [
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 60, "a_mm": 0, "alpha_deg": 90},
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 0, "a_mm": 116, "alpha_deg": 0},
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 0, "a_mm": 235, "alpha_deg": 0},
    ],
    "links": [{"mass_kg": 0.1, "com_mm": [0, 0, 0]}, {"mass_kg": 0.15, "com_mm": [-50, 0, 0]},
              {"mass_kg": 0.2, "com_mm": [-120, 0, 0]}],
}  # fmt: skip


@pytest.mark.parametrize("step_s", [1e-3, 2e-3, 5e-3])
def test_an_arm_of_servos_settles_where_its_own_weight_leaves_it(step_s: float) -> None:
    """Of 33 N m/rad, with a degree of backlash: it sags by degrees, so the loads at the readings are no longer its loads.

    A prediction takes them where the arm hangs; that of a version of before is told with how far it is off.
    """
    arm = Twin(
        robot_from_document(SERVO_ARM),
        {f"compliance_{j}": 1.0 / 33.0 for j in (1, 2, 3)}
        | {"backlash_load_2": math.radians(0.5), "backlash_load_3": math.radians(0.5)}
        | {"windup_2": -math.radians(0.3), "windup_3": -math.radians(0.3)},
        (make_effect("axial_compliance"), make_effect("backlash_load"), make_effect("friction_windup")),
    ).truth
    exported = export("mjcf", exportable(SERVO_ARM, arm))
    model = mujoco.MjModel.from_xml_string(str(exported.text))
    for q in ([0.3, 0.2, -0.5], [-0.8, 0.6, 0.3], [0.0, 1.0, -1.2]):
        for payload_kg in (0.0, 0.2):
            for side in (-1.0, 1.0):
                rows = Observations(np.array([q]), direction=np.full((1, 3), side), payload_kg=np.array([payload_kg]))
                found = settled(model, np.array(q), side, payload_kg, step_s, seconds=4.0)[0]
                assert np.linalg.norm(found - arm.predict(rows).position[0]) * 1e6 < CLOSE_WITH_BACKLASH_UM
    assert not any("takes the loads at the readings" in line for line in exported.notes)
    before = export("mjcf", exportable(SERVO_ARM, at_the_readings(arm)))
    apart = next(line for line in before.notes if "takes the loads at the readings" in line)
    assert float(apart.split(" um at most apart")[0].split()[-1]) > 50.0


def test_the_head_says_how_good_the_twin_is_where_it_was_not_fitted() -> None:
    file = exportable(preset_document("ur10"), Calibration.nominal(robot_from_document(preset_document("ur10"))))
    errors = StageErrors(
        n=30,
        registration_only=Errors(mean_mm=1.5),
        geometry_fitted=Errors(mean_mm=0.4),
        identified=Errors(mean_mm=0.125),
    )
    version = file.version.model_copy(update={"metrics": Metrics(validation=errors)})
    text = str(export("mjcf", dataclasses.replace(file, version=version)).text)
    assert "Held-out measured poses (30)" in text
    assert "nominal 1.5000 mm, rigid, calibrated 0.4000 mm, with the effects 0.1250 mm" in text
    assert "No measured poses were held out" in str(export("mjcf", file).text)


def test_a_soft_arm_hangs_where_its_own_loads_say() -> None:
    """At the readings the tool of an arm that sags by degrees would be a millimetre off."""
    soft = twin(("axial_compliance",), {f"compliance_{j}": 1.0 / 33.0 for j in range(1, 6)}, "so101")
    assert not any("a prediction of Kilter takes" in note for note in soft[0].notes)
    model, calibration = mujoco.MjModel.from_xml_string(str(soft[0].text)), soft[1]
    rows = Observations(np.random.default_rng(2).uniform(-1.2, 1.2, (4, 5)), payload_kg=np.full(4, 0.2))
    seen = np.array([settled(model, q, 1.0, 0.2, 2e-3, seconds=3.0)[0] for q in rows.q])
    apart = [
        np.linalg.norm(seen - told, axis=1).max()
        for told in (calibration.predict(rows).position, at_the_readings(calibration).predict(rows).position)
    ]
    assert apart[0] * 1e6 < CLOSE_UM < 1e2 < apart[1] * 1e6


def test_a_joint_that_drives_several_axes_is_refused() -> None:
    document: dict[str, Any] = {
        "name": "mimic", "convention": "chain",
        "elements": [{"axis": "Rz", "joint": "a"}, {"axis": "Tx", "value": 100.0, "name": "l"},
                     {"axis": "Rz", "joint": "a", "ratio": 0.5}],
        "joints": [{"name": "a", "limits_deg": [-90, 90]}],
    }  # fmt: skip
    with pytest.raises(RobotError, match="one axis per joint"):
        export("mjcf", exportable(document, Calibration.nominal(robot_from_document(document))))


def test_a_model_without_a_table_needs_no_step_and_a_later_one_is_refused() -> None:
    text = str(twin(("axial_compliance",), SAG)[0].text)
    model = mujoco.MjModel.from_xml_string(text)
    before = model.actuator_biasprm.copy()
    kilter.twin.apply(model, mujoco.MjData(model))
    assert np.array_equal(model.actuator_biasprm, before)
    later = str(stepped("encoder_scale")[0].text).replace("&quot;format&quot;: 1", "&quot;format&quot;: 2")
    model = mujoco.MjModel.from_xml_string(later)
    with pytest.raises(UsageError, match="update kilter-client"):
        kilter.twin.apply(model, mujoco.MjData(model))


def test_it_can_be_attached_to_a_scene() -> None:
    """A scene includes the model as it is; contacts, floor and cameras are the scene's."""
    root = ElementTree.fromstring(str(twin((), GEOMETRY)[0].text))
    assert {child.tag for child in root} == {"compiler", "option", "size", "worldbody", "actuator", "custom"}
