"""How far anybody's model of MuJoCo is from measured poses: the arm is left to settle at each, from its own side.

Base and tool point are fitted to the rows, as they are for the models of a server that it is compared with. SI inside.

A view tells the tool's place along its line of sight ten times worse than across it. So what corners scatter by about the pose
that fits their own view is noise, what views scatter by beyond it is the tool's, each as wide as is likeliest (EM), and the
errors of single views are scaled to scatter so. An evaluation by the server says millimetres of views in the same sense.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from csv import DictReader
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import FileError, UsageError
from kilter_client.twin.step import apply
from kilter_files.ground.later import mujoco, need, np
from kilter_files.match import rotations
from kilter_files.rig import FEWEST_CORNERS, FEWEST_VIEWS, SeenBoard, find_seen_boards

if TYPE_CHECKING:
    from kilter_files.ground import Floats


UNITS = {"deg": 0.017453292519943295, "rad": 1.0, "mm": 1e-3, "m": 1.0}
REACH = 0.02  # rad (m) before a pose from which its joints come
MOVES_S, RESTS_S = 1.0, 1.0
STEP_EVERY_S = 0.01  # how often what no element is is taken anew
AT_REST = 1e-3  # rad/s (m/s)
HINGE, SLIDE, JOINT = 3, 2, 0  # mjJNT_HINGE, mjJNT_SLIDE, mjTRN_JOINT
FEWEST_POINTS, ROUNDS = 6, 40


@dataclass(frozen=True)
class MeasuredRows:
    """Readings (N, n), sides (N, n) of the last motion (0: not known) and payloads (N,) kg.

    What was seen there: tool points ``points`` (N, 3), or ``views`` with the corners of a board and ``rig``, its cameras and
    boards, where the rows have no points.
    """

    readings: Floats
    sides: Floats
    payload_kg: Floats
    points: Floats | None
    views: Sequence[Mapping[str, Any]] = ()
    rig: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """What the model calls its ``joints``, its ``tool`` site and the body whose mass is the ``payload``; its step, s."""

    joints: Sequence[str]
    tool: str = "tool"
    payload: str = "payload"
    timestep_s: float | None = None


def read_measured_rows(content: bytes, joints: int, conditions: Mapping[str, Any], most: int) -> MeasuredRows:
    """Read the rows of a campaign, at most so many, evenly chosen; rows without a point, or without corners, are left out.

    Raises:
        UsageError: the campaign has neither tool points nor views, or fewer rows than base and tool need.

    """
    table = list(DictReader(io.StringIO(content.decode())))
    names = set(table[0]) if table else set()
    readings = [_column(table, names, f"q{j + 1}", ("deg", "rad", "mm", "m")) for j in range(joints)]
    points = [_column(table, names, axis, ("mm", "m")) for axis in "xyz"]
    rig = {name: conditions.get(name) or [] for name in ("cameras", "boards")}
    of_views = None in points and "u1_px" in names
    if None in readings or (None in points and not (of_views and all(rig.values()))):
        raise UsageError(
            "The campaign has neither q1_deg ... with x_mm, y_mm, z_mm nor q1_deg ... with u1_px, v1_px ... and the conditions "
            "cameras and boards: a model is compared with tool points or with views of a board."
        )
    sides = [_column_numbers(table, f"dir{j + 1}") for j in range(joints)]
    payload = (
        _column_numbers(table, "payload_kg")
        if "payload_kg" in names
        else [conditions.get("payload_kg") or 0.0] * len(table)
    )
    seen = np.array([_column_numbers(table, "u1_px")] if of_views else points, dtype=np.float64).T
    corners = [name for name in names if name.endswith("_px") and name[0] == "u"]
    whole = np.flatnonzero(
        [sum(bool(row[name]) for name in corners) >= FEWEST_CORNERS for row in table]
        if of_views
        else np.isfinite(seen).all(axis=1)
    )
    if len(whole) < FEWEST_POINTS:
        what = f"views of {FEWEST_CORNERS} corners or more" if of_views else "measured points"
        raise UsageError(f"The campaign has {len(whole)} {what}: base and tool need {FEWEST_POINTS} or more.")
    chosen = whole[np.unique(np.linspace(0, len(whole) - 1, min(most, len(whole))).round().astype(int))]
    return MeasuredRows(
        np.array(readings, dtype=np.float64).T[chosen],
        np.nan_to_num(np.array(sides, dtype=np.float64).T[chosen]),
        np.nan_to_num(np.array(payload, dtype=np.float64))[chosen],
        None if of_views else seen[chosen],
        [table[k] for k in chosen] if of_views else (),
        rig,
    )


def _column(table: list[dict[str, str]], names: set[str], name: str, units: Sequence[str]) -> list[float] | None:
    unit = next((unit for unit in units if f"{name}_{unit}" in names), None)
    return None if unit is None else [UNITS[unit] * value for value in _column_numbers(table, f"{name}_{unit}")]


def _column_numbers(table: list[dict[str, str]], name: str) -> list[float]:
    return [float(row.get(name) or "nan") for row in table]


def mujoco_package() -> Any:
    """Return MuJoCo.

    Raises:
        MissingPackageError: it is not installed.

    """
    return need("Models of MuJoCo need", "mujoco")


def load_model(path: Path) -> Any:
    """Load a model.

    Raises:
        FileError: MuJoCo refuses it: a file that it includes is missing or includes itself, a mesh is missing.
        MissingPackageError: MuJoCo is not installed.

    """
    mujoco = mujoco_package()
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        said = " ".join(str(error).split())
        code, remedy = _code_and_remedy(said)
        raise FileError(f"{path}: MuJoCo cannot load it: {said}. {remedy}", code=code, file=str(path)) from error


def _code_and_remedy(said: str) -> tuple[str, str]:
    """What is wrong with a model and what to do about it, by what MuJoCo says of it."""
    if "already included" in said:
        return (
            "model_includes",
            "Take out the <include> that names a file a second time: files that include each other have no end.",
        )
    if "opening file" in said:
        return "model_files", "Put the files that it names beside it, or mend the place that is named."
    return "model_invalid", "Mend the place that is named."


def model_errors(model: Any, rows: MeasuredRows, settings: Settings, path: Path) -> ViewErrors | Floats:
    """Distance (N,) m of each measured point from the settled tool, base and tool point fitted; of views their errors.

    Raises:
        FileError: the model has not these joints or this site, or does not settle at its time step.
        UsageError: views that do not say where camera and board stand.

    """
    silence_warnings()
    places, turns = [], []
    arm = _Arm.from_model(model, settings, path)
    for k in range(len(rows.readings)):
        place, turn = arm.settle(rows.readings[k], rows.sides[k], float(rows.payload_kg[k]))
        places.append(place)
        turns.append(turn)
    if rows.points is None:
        return errors_of_views(np.array(places), np.array(turns), rows.views, rows.rig)
    return distances_after_registration(np.array(places), np.array(turns), rows.points)


def silence_warnings() -> None:
    """MuJoCo writes its warnings into a file where one stands; what they say is said by the refusal."""
    mujoco.set_mju_user_warning(lambda _: None)


@dataclass(frozen=True)
class _Arm:
    """A model with the places of its joints, their drives (-1: none) and its tool."""

    model: Any
    joints: list[int]
    drives: list[int]
    site: int
    payload: int
    path: Path

    @classmethod
    def from_model(cls, model: Any, settings: Settings, path: Path) -> _Arm:
        joints = [find_element_id(model, "joint", name, path) for name in settings.joints]
        site = find_element_id(model, "site", settings.tool, path)
        drives = {
            int(model.actuator_trnid[a, 0]): a
            for a in range(model.nu)
            if int(model.actuator_trntype[a]) == JOINT and model.actuator_biasprm[a, 1] < 0.0
        }
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        if settings.timestep_s is not None:
            model.opt.timestep = settings.timestep_s
        payload = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, settings.payload)
        return cls(model, joints, [drives.get(j, -1) for j in joints], site, payload, path)

    def settle(self, reading: Floats, side: Floats, payload_kg: float) -> tuple[Floats, Floats]:
        """Place (3,) and rotation (3, 3) of the tool's site after the joints came to ``reading`` from their sides."""
        data = mujoco.MjData(self.model)
        self._hang(data, payload_kg)
        start = reading - REACH * side
        for j, value in zip(self.joints, start, strict=True):
            data.qpos[self.model.jnt_qposadr[j]] = value
        every = max(1, round(STEP_EVERY_S / self.model.opt.timestep))
        moves, rests = (round(s / self.model.opt.timestep) for s in (MOVES_S, RESTS_S))
        if not any(drive >= 0 for drive in self.drives):  # nothing holds it: it is where its joints are
            mujoco.mj_kinematics(self.model, data)
            moves = rests = 0
        for k in range(moves + rests):
            self._command(data, start + (reading - start) * min(1.0, (k + 1) / moves))
            if k % every == 0:
                apply(self.model, data)
            mujoco.mj_step(self.model, data)
        self._refuse_motion(data)
        mujoco.mj_kinematics(self.model, data)
        return data.site_xpos[self.site].copy(), data.site_xmat[self.site].reshape(3, 3).copy()

    def _hang(self, data: Any, payload_kg: float) -> None:
        if self.payload >= 0:
            self.model.body_mass[self.payload] = payload_kg
            mujoco.mj_setConst(self.model, data)
            mujoco.mj_resetData(self.model, data)
        elif payload_kg > 0.0:
            raise FileError(
                f"{self.path}: rows carry {payload_kg:g} kg, the model has no body for it: name one with --payload-body.",
                file=str(self.path),
            )

    def _command(self, data: Any, target: Floats) -> None:
        for joint, drive, value in zip(self.joints, self.drives, target, strict=True):
            if drive >= 0:
                data.ctrl[drive] = value
            else:
                data.qpos[self.model.jnt_qposadr[joint]] = value
                data.qvel[self.model.jnt_dofadr[joint]] = 0.0

    def _refuse_motion(self, data: Any) -> None:
        speeds = [abs(float(data.qvel[self.model.jnt_dofadr[j]])) for j in self.joints]
        kinds = mujoco.mjtWarning
        bad = (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
        if np.isfinite(data.qpos).all() and max(speeds) < AT_REST and not any(data.warning[k].number for k in bad):
            return
        raise FileError(
            f"{self.path}: the arm does not come to rest at steps of {self.model.opt.timestep * 1e3:g} ms: take smaller ones "
            "with --step-ms, or integrator='implicitfast'.",
            file=str(self.path),
        )


def find_element_id(model: Any, what: str, name: str, path: Path) -> int:
    """Return the number of a joint or site (``what``) of a model.

    Raises:
        FileError: it has none of that name.

    """
    kind, count = {
        "joint": (mujoco.mjtObj.mjOBJ_JOINT, model.njnt),
        "site": (mujoco.mjtObj.mjOBJ_SITE, model.nsite),
    }[what]
    found = int(mujoco.mj_name2id(model, kind, name))
    if found < 0:
        has = [mujoco.mj_id2name(model, kind, k) for k in range(count)]
        option = {"joint": "--joints A,B,C, in the robot's order", "site": "--site NAME"}[what]
        listed = ", ".join(one for one in has if one) or "none with a name"
        raise FileError(f"{path}: has no {what} {name!r}. It has: {listed}. Say which with {option}.", file=str(path))
    return found


def distances_after_registration(places: Floats, turns: Floats, points: Floats) -> Floats:
    """Distances (N,) of ``points (N, 3)`` from a tool point that hangs on the frames, base frame and tool point fitted."""
    R, b, t = _kabsch_alignment(places, points)[0], np.zeros(3), np.zeros(3)
    for _ in range(ROUNDS):
        own = places + turns @ t
        seen = own @ R.T
        left = points - seen - b
        J = np.zeros((len(points), 3, 9))
        J[:, 0, 1], J[:, 0, 2], J[:, 1, 2] = seen[:, 2], -seen[:, 1], seen[:, 0]
        J[:, 1, 0], J[:, 2, 0], J[:, 2, 1] = -seen[:, 2], seen[:, 1], -seen[:, 0]
        J[:, :, 3:6] = np.eye(3)
        J[:, :, 6:] = R @ turns
        step = np.linalg.lstsq(J.reshape(-1, 9), left.ravel(), rcond=1e-9)[0]
        R, b, t = _rotation_from_vector(step[:3].astype(np.float64)) @ R, b + step[3:6], t + step[6:]
    return np.asarray(np.linalg.norm(points - (places + turns @ t) @ R.T - b, axis=1))


def _kabsch_alignment(own: Floats, seen: Floats) -> tuple[Floats, Floats]:
    """Rotation and shift that bring points onto others at best (Kabsch)."""
    a, b = own - own.mean(axis=0), seen - seen.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return R, seen.mean(axis=0) - R @ own.mean(axis=0)


def _rotation_from_vector(w: Floats) -> Floats:
    angle = float(np.linalg.norm(w))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = w / angle
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * W + (1.0 - np.cos(angle)) * (W @ W))


STEP_MM, STEP_RAD = 1e-3, 1e-6
VIEW_ROUNDS = 80
PLACINGS = 6  # of finding how far off the model is, and placing camera and board again
SMALLEST_MM, SMALLEST_RAD = 1e-5, 1e-8
PARTS = slice(0, 3), slice(3, 6)  # of a motion: place and rotation


@dataclass(frozen=True)
class ViewErrors:
    """Errors ``tool`` (K,) m of the tool, ``rms_px`` of all corners, and ``noise_px`` about the pose of each view's own."""

    tool: Floats
    rms_px: float
    noise_px: float


def errors_of_views(
    places: Floats, turns: Floats, views: Sequence[Mapping[str, Any]], rig: Mapping[str, Any]
) -> ViewErrors:
    """Errors of settled tools, ``places`` (N, 3) m and ``turns`` (N, 3, 3), camera and board placed where they fit best.

    ``views`` have ``u1_px``, ``v1_px`` ..., ``rig`` names ``cameras`` and ``boards`` as a campaign does.

    Raises:
        UsageError: no camera and board of which the views tell where they stand.

    """
    tools = np.tile(np.eye(4), (len(places), 1, 1))
    tools[:, :3, :3], tools[:, :3, 3] = turns, 1e3 * places
    found = [_fit_camera_and_board(one.exactly(tools), tools) for one in find_seen_boards(views, tools, rig)]
    if not found:
        raise UsageError(
            f"The views do not say where camera and board stand by this model: {FEWEST_VIEWS} views of {FEWEST_CORNERS} "
            "corners of a flat board, from poses that rotate the tool about more than one axis, and a model that is "
            "roughly this arm do. Check --joints, --site and the conditions cameras and boards of the campaign."
        )
    told = [_fit_tool_motions(one, tools) for one in found]
    motions, covariances = (np.concatenate([one[k] for one in told]) for k in (0, 1))
    rest, corners, square = (sum(one[k] for one in told) for k in (2, 3, 4))
    beyond = corners - 6 * len(motions)
    noise = float(np.sqrt(rest / beyond))
    tool = 1e-3 * np.linalg.norm(_without_noise(motions, noise**2 * covariances)[:, :3], axis=1)
    return ViewErrors(np.asarray(tool), float(np.sqrt(square / corners)), noise)


def _fit_camera_and_board(one: SeenBoard, tools: Floats) -> SeenBoard:
    """Camera and board beside a model that need not be right: each view counts as far as views scatter.

    Corners alone hardly care how far away a board is, and would take a model for several times as far off as it is.
    """
    for _ in range(PLACINGS):
        motion, covariance, rest, corners, _ = _fit_tool_motions(one, tools)
        noise = rest / (corners - 6 * len(motion)) * covariance
        root = np.linalg.inv(np.linalg.cholesky(noise + np.diag(np.repeat(_scatter(motion, noise)[0], 3) ** 2)))
        moves = np.diag([STEP_RAD, STEP_RAD, STEP_RAD, STEP_MM, STEP_MM, STEP_MM] * 2)
        slopes = [(_fit_tool_motions(one.apply_pose_step(move), tools)[0] - motion) / move.sum() for move in moves]
        white = np.einsum("kij,ckj->kic", root, np.array(slopes)).reshape(-1, 12)
        one = one.apply_pose_step(np.linalg.lstsq(white, -np.einsum("kij,kj->ki", root, motion).ravel(), rcond=None)[0])
    return one


def _fit_tool_motions(one: SeenBoard, tools: Floats) -> tuple[Floats, Floats, float, int, float]:
    """Motions (K, 6) mm, rad of the tool that explain what is left of the views, their covariance for corners of 1 px.

    Then px² that they leave, how many numbers the corners are, and px² that were left.
    """
    own = tools[one.views]
    left = one.sight.reprojection_residuals(own, one.pixels)
    slopes = np.stack(
        [(one.sight.reprojection_residuals(_perturb_tools(own, k), one.pixels) - left) / _step(k) for k in range(6)],
        axis=-1,
    )
    shown = np.isfinite(left)
    A = np.where(shown[..., None], slopes, 0.0).reshape(len(own), -1, 6)
    r = np.where(shown, left, 0.0).reshape(len(own), -1)
    C = np.linalg.inv(A.transpose(0, 2, 1) @ A)
    motion = -np.einsum("nij,nkj,nk->ni", C, A, r)
    rest = r + np.einsum("nki,ni->nk", A, motion)
    return motion, C, float(np.sum(rest**2)), int(shown.sum()), float(np.sum(r**2))


def _step(k: int) -> float:
    return STEP_MM if k < 3 else STEP_RAD


def _perturb_tools(tools: Floats, k: int) -> Floats:
    """The tools moved along or rotated about an axis of the base, each about its own place."""
    moved, axis = tools.copy(), np.eye(3)[k % 3]
    if k < 3:
        moved[:, :3, 3] += STEP_MM * axis
    else:
        moved[:, :3, :3] = rotations(STEP_RAD * axis[None])[0] @ tools[:, :3, :3]
    return moved


def _without_noise(motions: Floats, noise: Floats) -> Floats:
    """Motions (K, 6) without their noise (K, 6, 6), that scatter as the tool does."""
    widths, kept = _scatter(motions, noise)
    for part, width in zip(PARTS, widths, strict=True):
        size = float(np.sqrt(np.mean(kept[:, part] ** 2)))
        kept[:, part] *= width / size if size > 0.0 else 1.0
    return np.asarray(kept)


def _scatter(motions: Floats, noise: Floats) -> tuple[list[float], Floats]:
    """Likeliest widths of place and rotation, and the motions (K, 6) as they are then likeliest."""
    precision, least = np.linalg.inv(noise), (SMALLEST_MM, SMALLEST_RAD)
    widths = [max(float(np.sqrt(np.mean(motions[:, part] ** 2))), own) for part, own in zip(PARTS, least, strict=True)]
    pull = precision @ motions[:, :, None]
    for _ in range(VIEW_ROUNDS):
        P = np.linalg.inv(precision + np.diag(np.repeat(np.array(widths) ** -2.0, 3)))
        kept = (P @ pull)[:, :, 0]
        second = kept**2 + np.diagonal(P, axis1=1, axis2=2)
        widths = [max(float(np.sqrt(second[:, part].mean())), own) for part, own in zip(PARTS, least, strict=True)]
    return widths, np.asarray(kept)
