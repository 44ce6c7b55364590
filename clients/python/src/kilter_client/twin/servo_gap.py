"""What a simulator lacks, from its model and logs of commands and readings: found, judged, and written into a copy."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import FileError, MissingPackageError
from kilter_client.twin.motion_step import FORMAT, TABLE, model_text, parse_table, read_joints
from kilter_client.twin.servo_model import CommandEpisode, CommandLog, ServoModel, read_command_log
from kilter_client.twin.settled import HINGE
from kilter_client.twin.simulators import BY_COMMAND, WRITERS, ExportedServo, Rendered
from kilter_client.twin.step import apply
from kilter_core.errors import CoreError
from kilter_core.motion import (
    JointFindings,
    JointFit,
    JointRecord,
    RolloutReport,
    describe_rollouts,
    draw_joint_ranges,
    find_missing_motion,
    find_start,
    prismatic_unit,
)
from kilter_core.parameters import FittedNumber
from kilter_core.parameters import write_json_for_yaml as write_json_for_yaml
from kilter_core.types import QUANTILE
from kilter_files.ground.later import mujoco, np

if TYPE_CHECKING:
    from kilter_files.formats import LogHints
    from kilter_files.ground import Floats


Progress = Callable[[float, str], None]
REFUTED = 1.5  # times the error of the numbers found, from which unseen episodes refute those that a model states
MISFIT = 2.0  # times the error of the search, from which the whole arm does not move as its joints do


@dataclass(frozen=True)
class LogOptions:
    """Names in the model (the log's ``joints``, the ``site`` at the tool, the ``payload`` body), and how the log is read.

    ``ranges_percent`` is what ranges of the numbers found cover.
    """

    joints: Sequence[str] = ()
    site: str | None = None
    payload: str = "payload"
    hints: LogHints | None = None
    column_map: Path | None = None
    ranges_percent: float = 95.0


def find_servo_gap(
    model: Path | str,
    logs: Sequence[Path | str],
    held: Sequence[Path | str] = (),
    options: LogOptions | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[dict[str, Any], Patched]:
    """Find what the joints of a model of MuJoCo lack, and write a copy that has it.

    Args:
        model: an MJCF file with a position actuator for each joint of the logs.
        logs: files with ``t_s, q1_deg ..., cmd1_deg ...``, or data sets of LeRobot; ``held`` of them only judge.
        held: further logs, that no choice sees; without them a third of the episodes is held out.
        options: names in the model, and how the logs are read.
        seed: chooses the episodes that are held out.
        progress: is called with a fraction and a stage.

    Returns:
        The document, and the copy.

    Raises:
        FileError: a model or log that cannot be what it should be, with place and remedy.
        MissingPackageError: MuJoCo is not installed.

    """
    options = options or LogOptions()
    arm = ServoModel.from_file(Path(model), options.joints, options.payload)
    site = _choose_site(arm, options.site)
    read = [read_command_log(Path(path), len(arm.joints), options.hints, options.column_map) for path in (*logs, *held)]
    records = arm.records(read)
    of_episode = [k for k, log in enumerate(read) for _ in log.episodes]
    try:
        whole = partial(_replay_fits, arm, records, [one for log in read for one in log.episodes])
        report = find_missing_motion(records, of_episode, range(len(logs), len(read)), whole, seed, progress)
        document = describe_rollouts(report)
    except CoreError as error:
        raise FileError(f"{logs[0]}: {error.message}", code=error.code, **error.context) from error
    copy = patch_model(arm, records, {one.record.name: one.believed for one in report.joints})
    copy = replace(copy, servos=tuple(_list_servo(one) for one in report.joints))
    document["model"] = str(model)
    document["whole_arm"] = _judge_whole_arm(arm, report, records, copy, read, site)
    document["notes"] = list(copy.notes)
    document["warnings"] += [*_list_dropped(read), *_compare_whole_arm(document)]
    document["refuted"] = _is_refuted(document)
    document["ranges"] = draw_joint_ranges(report.joints, options.ranges_percent / 100.0, seed)
    return document, copy


def _choose_site(arm: ServoModel, site: str | None) -> str | None:
    """The site that is named; else one called tool, gripper or the like; else the last of the model."""
    names = [mujoco.mj_id2name(arm.model, mujoco.mjtObj.mjOBJ_SITE, k) for k in range(arm.model.nsite)]
    names = [name for name in names if name]
    if site is not None and site not in names:
        listed = ", ".join(names) or "none with a name"
        raise FileError(
            f"{arm.path}: has no site {site!r}. It has: {listed}. Say which with --site.", file=str(arm.path)
        )
    return site or next((name for name in names if "tool" in name), names[-1] if names else None)


def _judge_whole_arm(
    arm: ServoModel,
    report: RolloutReport,
    every_joint: Sequence[JointRecord],
    copy: Patched,
    logs: Sequence[CommandLog],
    site: str | None,
) -> dict[str, Any]:
    """Errors of the whole arm in MuJoCo on unseen episodes: the model as it is, with its servos fitted, and the copy."""
    every = [one for log in logs for one in log.episodes]
    places = report.held_episodes or tuple(range(len(every)))
    held = [every[k] for k in places]
    records = [one.record for one in report.joints]
    used = records[0].used[np.isin(records[0].episode, places)]
    measured = np.concatenate([one.reading for one in held])[used]
    at = None if site is None else tool_points(arm, measured, site)
    base = {one.record.name: one.base for one in report.joints}
    believed = {one.record.name: one.believed for one in report.joints}
    servos = patch_model(arm, records, base)
    models = {"stated": (arm.model, {}), "servo_fitted": (servos.model, base), "found": (copy.model, believed)}
    found: dict[str, Any] = {"unseen": report.unseen, "site": site}
    for name, (model, fits) in models.items():
        read = replay_readings(arm, model, held, find_starts(every_joint, fits, places))
        tool = None if at is None else np.linalg.norm(at - tool_points(arm, read[used], str(site)), axis=1)
        found[name] = _describe_replay(arm, measured - read[used], tool) if np.isfinite(read).all() else None
    return found


def _replay_fits(
    arm: ServoModel, records: Sequence[JointRecord], episodes: Sequence[CommandEpisode], fits: Mapping[str, JointFit]
) -> dict[str, Floats]:
    """Readings (R,) of each joint in MuJoCo, with these fits of some of them."""
    starts = find_starts(records, fits, range(len(episodes)))
    readings = replay_readings(arm, patch_model(arm, records, fits).model, episodes, starts)
    return dict(zip(arm.joints, readings.T, strict=True))


def _describe_replay(arm: ServoModel, apart: Floats, tool: Floats | None) -> dict[str, Any]:
    """Errors of readings (R, n) rad, and of the tool (R,) m, None without a site."""
    revolute = [k for k, j in enumerate(arm.ids) if int(arm.model.jnt_type[j]) == HINGE]
    return {
        "rms_deg": float(np.degrees(np.sqrt(np.mean(apart[:, revolute] ** 2)))),
        "tool_rms_mm": None if tool is None else float(1e3 * np.sqrt(np.mean(tool**2))),
        "tool_max_mm": None if tool is None else float(1e3 * np.max(tool)),
    }


def _is_refuted(document: dict[str, Any]) -> bool:
    stated, found = document["whole_arm"]["stated"], document["whole_arm"]["found"]
    return stated is None or (found is not None and stated["rms_deg"] > REFUTED * found["rms_deg"])


def _compare_whole_arm(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Say where the whole arm in MuJoCo does not do what its joints did one by one."""
    found = document["whole_arm"]["found"]
    alone = float(np.sqrt(np.mean([one["found"] ** 2 for one in document["joints"] if one["unit"] == "deg"] or [0.0])))
    if found is not None and found["rms_deg"] <= MISFIT * max(alone, 1e-6):
        return []
    what = "diverges" if found is None else f"is {found['rms_deg']:.2g} deg off, its joints one by one {alone:.2g} deg"
    remedy = "Take a smaller time step, or check the masses of the model."
    return [{"code": "whole_arm_differs", "message": f"The copy as a whole {what}. {remedy}"}]


def _list_dropped(logs: Sequence[CommandLog]) -> list[dict[str, Any]]:
    named = [f"{log.dropped} of {log.path}" for log in logs if log.dropped]
    if not named:
        return []
    message = f"Rows are missing: {', '.join(named)}. The last command is held over each gap."
    return [{"code": "rows_missing", "message": message}]


def find_starts(records: Sequence[JointRecord], fits: Mapping[str, JointFit], places: Iterable[int]) -> Floats:
    """Angles and speeds (E, n, 2) of joints at the start of episodes, with these fits of some of them."""
    numbers = [fits[one.name].p if one.name in fits else one.stated for one in records]
    return np.array([[find_start(one, p, k) for one, p in zip(records, numbers, strict=True)] for k in places])


def replay_readings(arm: ServoModel, model: Any, episodes: Sequence[CommandEpisode], starts: Floats) -> Floats:
    """Readings (R, n) of an arm, its own model or a patched copy, in some episodes from ``starts (E, n, 2)``.

    They are not finite where it diverges.
    """
    return np.concatenate([_run(arm, model, one, start) for one, start in zip(episodes, starts, strict=True)])


def _run(arm: ServoModel, model: Any, one: CommandEpisode, start: Floats) -> Floats:
    arm.hang(model, one)
    data = mujoco.MjData(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    places = [int(model.joint(name).qposadr[0]) for name in arm.joints]
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints]
    text = model_text(model, TABLE)
    table = {} if text is None else parse_table(text)["joints"]
    data.qpos[places] = start[:, 0] - [table.get(name, {}).get("reading_offset", 0.0) for name in arm.joints]
    data.qvel[dofs] = start[:, 1]
    _fill_history(arm, model, data, one.command[0])
    mujoco.mj_forward(model, data)
    steps = np.round((one.t - one.t[0]) / model.opt.timestep).astype(int)
    read = np.empty_like(one.reading)
    for k in range(len(one.t)):
        read[k] = data.qpos[places]
        if table:
            sensed = read_joints(model, data)
            read[k] = [sensed.get(name, value) for name, value in zip(arm.joints, read[k], strict=True)]
        data.ctrl[list(arm.actuators)] = one.command[k]
        count = int(steps[k + 1] - steps[k]) if k + 1 < len(steps) else 0
        if not table and count:
            mujoco.mj_step(model, data, count)
        for _ in range(count if table else 0):
            apply(model, data)
            mujoco.mj_step(model, data)
    return read


def _fill_history(arm: ServoModel, model: Any, data: Any, command: Floats) -> None:
    """Let commands that come late be the first one before the log begins."""
    for actuator, value in zip(arm.actuators, command, strict=True):
        count = int(model.actuator_history[actuator, 0]) if hasattr(model, "actuator_history") else 0
        if count:
            times = (np.arange(count) - count) * model.opt.timestep
            mujoco.mj_initCtrlHistory(model, data, actuator, times, np.full(count, value))


def tool_points(arm: ServoModel, readings: Floats, site: str) -> Floats:
    """Points (N, 3) m of a site at readings (N, n), by the user's own model."""
    model, data = arm.model, mujoco.MjData(arm.model)
    at = model.site(site).id
    places = [int(model.jnt_qposadr[j]) for j in arm.ids]
    points = np.empty((len(readings), 3))
    for k, reading in enumerate(readings):
        data.qpos[places] = reading
        mujoco.mj_kinematics(model, data)
        points[k] = data.site_xpos[at]
    return points


HARD_FRICTION = ((0.01, 1.0), (0.9999, 0.9999, 1e-6, 0.5, 2.0))  # holds to the micrometre, see the exported twin
BACKLASH_LIMITS = ((0.004, 1.0), (0.99, 0.9999, 1e-6, 0.5, 2.0))
BACKLASH_ARMATURE, BACKLASH_RATE = (
    0.02,
    10.0,
)  # of the motor's armature; 1/s, at which backlash that nothing loads comes to rest
DEGREES = 57.29577951308232
LINEAR = 1  # between samples of the past: else a delay counts in whole steps
STEP = "Call kilter.twin.apply(model, data) before every mj_step; kilter.twin.read_joints gives the readings."


@dataclass(frozen=True)
class Patched:
    """The compiled copy, its text, and what to know of it."""

    model: Any
    text: str
    notes: tuple[str, ...]
    servos: tuple[ExportedServo, ...] = ()


def _list_servo(found: JointFindings) -> ExportedServo:
    """Numbers of a joint for simulators that are not MuJoCo."""
    fit, values, slides = found.believed, found.believed.values, found.record.slides
    delay = next((one for one in found.judged if one.term.effect.id == BY_COMMAND), None)
    half = 0.0 if delay is None else QUANTILE * delay.sigma
    effects = {}
    for number, key in zip(fit.fitted, fit.names, strict=True):
        if key not in values and key not in (BY_COMMAND, "torque_limit"):
            unit = prismatic_unit(number.unit) if slides else number.unit
            effects[FittedNumber(key, unit, 0.0).key] = float(fit.p[number.place])
    return ExportedServo(
        found.record.name,
        values["armature"],
        values["friction"],
        values["damping"],
        values["damping"] * values["servo_share"],
        values["gain"],
        values["torque_limit"] or None,
        None if delay is None else (delay.value, delay.value - half, delay.value + half),
        effects,
        (values["impedance"], values["rate"]) if fit.creeps else None,
    )


def patch_model(arm: ServoModel, records: Sequence[JointRecord], fits: Mapping[str, JointFit]) -> Patched:
    """Write a copy of a model with the servos of some joints as they were ``fits``, by name, and what these lack.

    Raises:
        MissingPackageError: a delay needs a release of MuJoCo that knows it.

    """
    spec = mujoco.MjSpec.from_file(str(arm.path))
    patch = _Patch(spec, arm, int(spec.nuserdata))
    for record in records:
        if record.name in fits:
            patch.set_joint(record, fits[record.name])
    if patch.table:
        spec.nuserdata = patch.numbers
        spec.add_text(name=TABLE, data=json.dumps({"format": FORMAT, "joints": patch.table}))
        patch.notes.append(STEP)
    if patch.joints_added:
        for key in list(spec.keys):
            patch.notes.append(
                f"Keyframe {key.name or 'without a name'} is left out: the copy has more joints than it."
            )
            spec.delete(key)
    folder = arm.path.resolve().parent
    spec.meshdir, spec.texturedir = (str(folder / part) for part in (spec.meshdir, spec.texturedir))
    return Patched(spec.compile(), spec.to_xml(), tuple(dict.fromkeys(patch.notes)))


def render_copy(form: str, name: str, copy: Patched) -> Rendered:
    """Write a copy for a simulator: ``mjcf``, or one of :data:`WRITERS`."""
    if form == "mjcf":
        return Rendered(copy.text, ())
    return WRITERS[form](name, mujoco.MjModel.from_xml_string(copy.text), copy.servos)


@dataclass
class _Patch:
    """A copy as it is changed: its table for the step, and how many numbers of ``userdata`` that needs."""

    spec: Any
    arm: ServoModel
    numbers: int
    table: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    joints_added: int = 0

    def set_joint(self, record: JointRecord, fit: JointFit) -> None:
        """Set the servo of a joint, and add the effects of its fit."""
        joint = _JointPatch(self, self.arm.joints.index(record.name), record, fit)
        joint.set_servo()
        sizes = {term.effect.id: float(fit.p[term.effect.number.place]) for term in fit.terms}
        for effect, size in sizes.items():
            if size != 0.0:  # a fit may find that it is not there
                getattr(joint, f"add_{effect}")(size)
        if joint.row:
            stated = {"actuator": joint.actuator.name, "friction": fit.values["friction"], "slip_speed": fit.slip_speed}
            self.table[record.name] = stated | joint.row


@dataclass
class _JointPatch:
    """A joint of a copy: each effect is added as an element of MuJoCo, or as a number in the ``row`` of the table."""

    patch: _Patch
    place: int
    record: JointRecord
    fit: JointFit
    row: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def joint(self) -> Any:
        return self.patch.spec.joint(self.record.name)

    @cached_property
    def actuator(self) -> Any:
        found = self.patch.spec.actuators[self.patch.arm.actuators[self.place]]
        found.name = found.name or f"{self.record.name}_servo"
        return found

    @property
    def gear(self) -> float:
        return float(self.actuator.gear[0])

    @property
    def written_per_rad(self) -> float:
        """Units in which the source writes the angle of this joint, for each radian (m)."""
        hinge = self.joint.type == mujoco.mjtJoint.mjJNT_HINGE
        return DEGREES if self.patch.spec.compiler.degree and hinge else 1.0

    @property
    def timestep_s(self) -> float:
        return float(self.patch.arm.model.opt.timestep)

    def set_servo(self) -> None:
        values = self.fit.values
        servo = values["damping"] * values["servo_share"]
        self.joint.armature, self.joint.frictionloss = values["armature"], values["friction"]
        self.joint.damping = _as_before(self.joint.damping, values["damping"] - servo)
        self.actuator.gainprm[0] = values["gain"] / self.gear**2
        self.actuator.biasprm[1], self.actuator.biasprm[2] = -values["gain"] / self.gear**2, -servo / self.gear**2
        if not self.fit.creeps:
            self.joint.solref_friction, self.joint.solimp_friction = HARD_FRICTION
            self.patch.notes.append("Friction holds a joint without creep: solreffriction and solimpfriction are set.")

    def add_command_delay(self, size: float) -> None:
        if size <= 0.0:
            self.patch.notes.append(f"The commands of {self.record.name} act {-size * 1e3:.0f} ms before the log says.")
            return
        if not hasattr(self.actuator, "delay"):
            raise MissingPackageError("A delay needs MuJoCo 3.5: pip install --upgrade mujoco.", package="mujoco")
        self.actuator.delay, self.actuator.nsample = size, math.ceil(size / self.timestep_s) + 2
        self.actuator.interp = LINEAR
        self.patch.notes.append("The delay of a command is an element of MuJoCo 3.5 and later.")

    def add_effort_delay(self, size: float) -> None:
        length = math.ceil(size / self.timestep_s) + 3
        self.row |= {"effort_delay": size, "ring": [self._take_numbers(length), length]}

    def add_sensor_lag(self, size: float) -> None:
        self.row |= {"sensor_lag": size, "lag_at": self._take_numbers(1)}

    def _take_numbers(self, count: int) -> int:
        first = self.patch.numbers
        self.patch.numbers += count
        return first

    def add_torque_limit(self, size: float) -> None:
        limit = size / abs(self.gear)
        self.actuator.forcelimited, self.actuator.forcerange = True, [-limit, limit]

    def add_backlash(self, size: float) -> None:
        second = self._add_second_joint()
        second.armature = BACKLASH_ARMATURE * self.joint.armature
        half = 0.5 * size * self.written_per_rad
        second.limited, second.range = True, [-half, half]
        second.solref_limit, second.solimp_limit = BACKLASH_LIMITS
        second.damping = _as_before(second.damping, BACKLASH_RATE * second.armature)

    def add_flexible_gear(self, size: float) -> None:
        second = self._add_second_joint()
        second.stiffness = _as_before(second.stiffness, 1.0 / size)
        second.damping = _as_before(second.damping, self.fit.values["gear_damping"] / size)

    def _add_second_joint(self) -> Any:
        """A joint behind the first on the same axis: the first moves the motor, both the bodies."""
        first, name = self.joint, f"{self.record.name}_gear"
        self.patch.joints_added += 1
        sides = {key: bool(self.fit.values[key]) for key in ("servo_behind", "reads_behind")}
        self.row |= {"second": name} | sides
        return first.parent.add_joint(name=name, type=first.type, axis=list(first.axis), pos=list(first.pos))

    def add_zero_offset(self, size: float) -> None:
        self.joint.ref += size * self.written_per_rad

    def add_load_friction(self, size: float) -> None:
        self.row |= {"load_friction": size, "moving_load": bool(self.fit.values["moving_load"])}

    def add_stick(self, size: float) -> None:
        self.row["stick"] = size

    def add_reading_offset(self, size: float) -> None:
        self.row["reading_offset"] = size


def _as_before(old: Any, value: float) -> Any:
    """A damping or stiffness as this release of MuJoCo holds it: a number, or a polynomial."""
    return value if isinstance(old, float) else [value, *([0.0] * (len(old) - 1))]
