"""A version as USD: calibrated joints, drives that deflect as the joints do, and attributes for the rest.

The stage is made in a process of its own: Pixar's package and its caches stay with whoever loads them, 90 MB.
It is started as ``python -m kilter_service.robots.exporters.usd_file``, in a folder with what is asked.
"""

from __future__ import annotations

import json
import pickle
import tempfile
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.arm import Link, moved_link
from kilter_core.model import wanted_tool
from kilter_core.transforms import inverse, pose_from_twist
from kilter_files.robots import NOMINAL, STEP_TABLE, TOOL, local_pose, single, split, usd_package
from kilter_service.ground import child_process
from kilter_service.ground.child_process import Limits, confine
from kilter_service.ground.errors import ServiceError
from kilter_service.robots.exporters.exportable import Exportable, Written
from kilter_service.robots.exporters.mjcf_file import LEAST_INERTIA, identified_axes, nominal_poses, possible, thickness
from kilter_service.robots.exporters.mjcf_notes import (
    Drive,
    ExportedEffects,
    drives,
    exported_effects,
    notes,
    of_sharpened,
    passive_joint_part,
    table,
)

if TYPE_CHECKING:
    from kilter_core.model import Calibration
    from kilter_core.types import Floats


CHILD = "kilter_service.robots.exporters.usd_file"
ASKED, MADE = "asked", "made.usda"
LIMITS = Limits(seconds=60, memory_mb=3072, output_mb=64)
KERNELS = ("NUMBA_CACHE_DIR",)
_KNOWN = (
    "Lengths in m, masses in kg, z up; angles of UsdPhysics in degrees: drives in N m/deg (of a prismatic joint N/m), limits "
    "in deg (m). Attributes of Kilter have their unit in their name. Targets of the drives are the readings of the controller.",
    "Local poses of joints are in single precision. What rounding leaves of each is in the other local pose of the body: "
    "read in double precision the joints are exactly those of the version.",
    "Not calibrated: inertia and damping of the drives, speed and torque limits. The twin is true where it has settled.",
)

LEAST_MASS = 1e-6  # kg: a mass of zero has UsdPhysics guess one from shapes
SETTLES_S = 0.05  # damping by stiffness: a drive that nothing else slows comes to rest with this time constant


def usd(version: Exportable) -> Written:
    """Write the stage as text (usda); its documentation has what it cannot say.

    Raises:
        RobotError: a joint drives several axes.
        ServiceError: the server lacks the package of USD.

    """
    if find_spec("pxr") is None:
        raise ServiceError(
            "USD needs its package, and this server lacks it: install it there with `pip install usd-core`, or take "
            "another format.",
            code="usd_unavailable",
        )
    exported, _ = _exported_with_drives(version)
    held = [effect for effect in exported.in_elements if effect not in exported.beyond_drives]
    partly = [effect for effect in exported.in_both if effect not in exported.beyond_drives]
    beyond = [*exported.beyond_drives, *exported.in_step]
    placed = (
        ("In the stage", held),
        ("In the stage, and of some joints in attributes only (kilter:*), which no simulator reads by itself", partly),
        ("In attributes only (kilter:*), which no simulator reads by itself", beyond),
        ("Left out", exported.left_out),
    )
    weighed = {joint for joint, _ in identified_axes(version.calibration, exported).bodies}
    light = (f"Bodies whose masses the robot does not state weigh {LEAST_MASS * 1e3:g} g.",)
    all_weighed = len(weighed) > version.calibration.robot.n_joints  # the base too
    told = (*of_sharpened(exported), *_KNOWN, *(() if all_weighed else light))
    written = notes(version.version, version.calibration, placed, told)
    head = f"Calibrated by Kilter: version {version.version.id} of robot {version.version.robot}."
    return Written(partial(_text_by_child, version, "\n".join((head, *written))), written)


def stage_text(version: Exportable, documentation: str) -> str:
    """Return a version's stage as text."""
    title = f"{version.version.robot} {version.version.id}"
    return Stage(title, version.calibration, *_exported_with_drives(version)).text(documentation)


def _exported_with_drives(version: Exportable) -> tuple[ExportedEffects, list[Drive]]:
    exported = exported_effects(version.calibration)
    return exported, drives(exported.robot, [passive_joint_part(joint) for joint in exported.form.joints])


def _text_by_child(version: Exportable, documentation: str) -> str:
    with tempfile.TemporaryDirectory(prefix="kilter-usd-") as name:
        folder = Path(name)
        (folder / ASKED).write_bytes(pickle.dumps((replace(version), documentation)))
        ended = child_process.run(CHILD, folder, [], LIMITS, KERNELS)
        if ended.code == 0:
            return (folder / MADE).read_text(encoding="utf-8")
    why = f"took longer than {LIMITS.seconds} s" if ended.late else f"could not be made ({ended.words.strip()[-200:]})"
    raise ServiceError(f"The stage of USD {why}: try again, or take another format.", code="usd_unavailable")


class Stage:
    """A stage in memory."""

    def __init__(self, title: str, calibration: Calibration, exported: ExportedEffects, driven: list[Drive]) -> None:
        pxr = usd_package()
        self.pxr, self.exported, self.calibration = pxr, exported, calibration
        self.stage = pxr.Usd.Stage.CreateInMemory()
        pxr.UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        pxr.UsdPhysics.SetStageKilogramsPerUnit(self.stage, 1.0)
        pxr.UsdGeom.SetStageUpAxis(self.stage, pxr.UsdGeom.Tokens.z)
        self.root = f"/{pxr.Tf.MakeValidIdentifier(title)}"
        self.axes = identified_axes(calibration, exported)
        self.thick = thickness(self.axes)
        self._names = self._unique([joint.name for joint in calibration.robot.joints])
        self._scene()
        self._arm(driven)

    def text(self, documentation: str) -> str:
        """The stage as text, with its notes."""
        layer = self.stage.GetRootLayer()
        layer.documentation = documentation
        return str(layer.ExportToString())

    def _unique(self, names: list[str]) -> list[str]:
        out: list[str] = []
        for name in names:
            plain = self.pxr.Tf.MakeValidIdentifier(name)
            while plain in out:
                plain += "_"
            out.append(plain)
        return out

    def _scene(self) -> None:
        gravity = np.asarray(self.exported.robot.gravity)
        size = float(np.linalg.norm(gravity))
        scene = self.pxr.UsdPhysics.Scene.Define(self.stage, f"{self.root}/gravity")
        scene.CreateGravityMagnitudeAttr(size)
        scene.CreateGravityDirectionAttr(self.pxr.Gf.Vec3f(*(gravity / size).tolist() if size else (0.0, 0.0, -1.0)))

    def _arm(self, driven: list[Drive]) -> None:
        """Base, joints and what they carry; the frame of a body is that of its joint but for what rounding leaves."""
        pxr, joints, frames = self.pxr, self.calibration.robot.joints, self.axes.joints
        arm = pxr.UsdGeom.Xform.Define(self.stage, self.root).GetPrim()
        self.stage.SetDefaultPrim(arm)
        pxr.UsdPhysics.ArticulationRootAPI.Apply(arm)
        self._attributes(arm)
        # The stage holds the base where single precision has it, and the base takes the rest.
        stand = single(self.axes.base)
        before, behind = split(inverse(self.axes.base) @ stand, inverse(self.axes.base) @ frames[0])
        pose = stand @ inverse(before)
        path = self._body("base", pose, frames[0], -1, before)
        fixed = pxr.UsdPhysics.FixedJoint.Define(self.stage, f"{self.root}/joints/base")
        self._hold(fixed, None, path, stand, before)
        for j in range(len(joints)):
            last = j + 1 == len(joints)
            ahead = self.axes.flange if last else frames[j + 1]
            own, next_ = (np.eye(4), np.eye(4)) if last else split(np.eye(4), inverse(frames[j]) @ ahead)
            pose = frames[j] @ inverse(own)
            body = self._body(f"{self._names[j]}_link", pose, ahead, j, own)
            self._hold(self._joint(j, driven[j]), path, body, behind, own)
            path, behind = body, next_
        self._tool(path, inverse(pose) @ self.axes.flange @ wanted_tool(self.calibration), pose)

    def _joint(self, j: int, drive: Drive) -> Any:
        """A joint with its limits, its drive, and as attributes what no drive has."""
        UsdPhysics, Sdf = self.pxr.UsdPhysics, self.pxr.Sdf
        joint = self.calibration.robot.joints[j]
        prismatic = joint.kind == "prismatic"
        kind, token = (UsdPhysics.PrismaticJoint, "linear") if prismatic else (UsdPhysics.RevoluteJoint, "angular")
        made = kind.Define(self.stage, f"{self.root}/joints/{self._names[j]}")
        made.CreateAxisAttr("Z")
        per = 1.0 if prismatic else float(np.degrees(1.0))  # degrees of a radian
        if np.isfinite(joint.lower):
            made.CreateLowerLimitAttr(joint.lower * per)
        if np.isfinite(joint.upper):
            made.CreateUpperLimitAttr(joint.upper * per)
        own = UsdPhysics.DriveAPI.Apply(made.GetPrim(), token)
        own.CreateTypeAttr("force")
        own.CreateStiffnessAttr(drive.gain / per)
        own.CreateDampingAttr(drive.gain / per * SETTLES_S)
        own.CreateTargetPositionAttr(0.0)
        length, force = ("M", "N") if prismatic else ("Rad", "Nm")
        values = {f"halfBacklash{length}": drive.backlash, f"friction{force}": drive.friction}
        for name, value in values.items():
            if value > 0.0:
                made.GetPrim().CreateAttribute(f"kilter:{name}", Sdf.ValueTypeNames.Double).Set(value)
        made.GetPrim().CreateAttribute("kilter:joint", Sdf.ValueTypeNames.String).Set(joint.name)
        made.GetPrim().CreateAttribute("kilter:number", Sdf.ValueTypeNames.Int).Set(j + 1)
        return made

    def _hold(self, joint: Any, before: str | None, behind: str, at_before: Floats, at_behind: Floats) -> None:
        if before is not None:
            joint.CreateBody0Rel().SetTargets([before])
        joint.CreateBody1Rel().SetTargets([behind])
        for k, T in enumerate((at_before, at_behind)):
            place, turn = local_pose(T)
            getattr(joint, f"CreateLocalPos{k}Attr")(self.pxr.Gf.Vec3f(*place))
            getattr(joint, f"CreateLocalRot{k}Attr")(self.pxr.Gf.Quatf(turn[0], *turn[1:]))

    def _body(self, name: str, pose: Floats, ahead: Floats, j: int, own: Floats) -> str:
        """A body at ``pose`` in the base; its joint is at ``own`` in it."""
        path = f"{self.root}/{name}"
        body = self._define_placed_xform(path, pose)
        self.pxr.UsdPhysics.RigidBodyAPI.Apply(body)
        twist = self.exported.form.joints[j].twist if j >= 0 else np.zeros(6)
        behind = own @ pose_from_twist(twist[:3], twist[3:])
        self._weigh(body, [moved_link(link, behind) for k, link in self.axes.bodies if k == j])
        self._drawn(path, inverse(pose) @ ahead)
        return path

    def _define_placed_xform(self, path: str, T: Floats) -> Any:
        xform, (place, turn) = self.pxr.UsdGeom.Xform.Define(self.stage, path), local_pose(T)
        double = self.pxr.UsdGeom.XformOp.PrecisionDouble
        xform.AddTranslateOp(double).Set(self.pxr.Gf.Vec3d(*place))
        xform.AddOrientOp(double).Set(self.pxr.Gf.Quatd(turn[0], *turn[1:]))
        return xform.GetPrim()

    def _weigh(self, body: Any, links: list[Link]) -> None:
        """One mass of several: their centre, and their inertia about it along its own axes."""
        mass = sum(float(link.mass) for link in links)
        com, inertia = np.zeros(3), np.zeros((3, 3))
        if mass > 0.0:
            com = sum((link.mass * np.asarray(link.com) for link in links), np.zeros(3)) / mass
        for link in links:
            r = np.asarray(link.com) - com
            inertia = inertia + np.asarray(link.inertia) + link.mass * (r @ r * np.eye(3) - np.outer(r, r))
        sizes, turn = np.linalg.eigh(possible(inertia))
        principal = np.eye(4)
        principal[:3, :3] = turn * np.sign(np.linalg.det(turn))
        own, (_, (w, *xyz)) = self.pxr.UsdPhysics.MassAPI.Apply(body), local_pose(principal)
        own.CreateMassAttr(max(mass, LEAST_MASS))
        own.CreateCenterOfMassAttr(self.pxr.Gf.Vec3f(*com.tolist()))
        own.CreateDiagonalInertiaAttr(self.pxr.Gf.Vec3f(*np.maximum(sizes, LEAST_INERTIA).tolist()))
        own.CreatePrincipalAxesAttr(self.pxr.Gf.Quatf(w, *xyz))

    def _tool(self, path: str, tool: Floats, pose: Floats) -> None:
        """The tool's frame, and the payload as a body that hangs on it."""
        self._define_placed_xform(f"{path}/{TOOL}", tool)
        payload = self.exported.payload
        if payload.mass <= 0.0:
            return
        at = tool.copy()
        at[:3, 3] += tool[:3, :3] @ np.asarray(payload.com)
        body = self._define_placed_xform(f"{self.root}/payload", pose @ at)
        self.pxr.UsdPhysics.RigidBodyAPI.Apply(body)
        self._weigh(body, [Link(element=0, mass=payload.mass, com=np.zeros(3), inertia=np.zeros((3, 3)))])
        fixed = self.pxr.UsdPhysics.FixedJoint.Define(self.stage, f"{self.root}/joints/payload")
        self._hold(fixed, path, f"{self.root}/payload", at, np.eye(4))

    def _attributes(self, arm: Any) -> None:
        """What no element of UsdPhysics is: a base that deflects, the table of the step; and where joints nominally are."""
        types = self.pxr.Sdf.ValueTypeNames
        base = self.exported.form.base_compliance
        if base is not None and any(c > 0.0 for c in base):
            arm.CreateAttribute("kilter:baseComplianceRadPerNm", types.Double2).Set(self.pxr.Gf.Vec2d(*base))
        rest = table(self.exported.form)
        if rest is not None:
            arm.CreateAttribute(STEP_TABLE, types.String).Set(json.dumps(json.loads(rest)))
        frames = [number for T in nominal_poses(self.calibration) for part in local_pose(T) for number in part]
        arm.CreateAttribute(NOMINAL, types.DoubleArray).Set(frames)

    def _drawn(self, path: str, T: Floats) -> None:
        """A rod to the next frame, to look at: it weighs nothing and touches nothing."""
        length = float(np.linalg.norm(T[:3, 3]))
        if length <= self.thick:
            return
        rod = self.pxr.UsdGeom.Capsule.Define(self.stage, f"{path}/rod")
        rod.CreateAxisAttr("Z")
        rod.CreateHeightAttr(length)
        rod.CreateRadiusAttr(self.thick)
        turn = self.pxr.Gf.Rotation(self.pxr.Gf.Vec3d(0, 0, 1), self.pxr.Gf.Vec3d(*T[:3, 3].tolist())).GetQuat()
        rod.AddTranslateOp().Set(self.pxr.Gf.Vec3d(*(0.5 * T[:3, 3]).tolist()))
        rod.AddOrientOp(self.pxr.UsdGeom.XformOp.PrecisionDouble).Set(turn)
        rod.CreateDisplayColorAttr([self.pxr.Gf.Vec3f(0.6, 0.65, 0.7)])


def main() -> None:
    """Write the stage as text."""
    confine()
    version, documentation = pickle.loads(Path(ASKED).read_bytes())  # noqa: S301 (our own)
    Path(MADE).write_text(stage_text(version, documentation), encoding="utf-8")


if __name__ == "__main__":
    main()
