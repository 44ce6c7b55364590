"""A twin laid over somebody's own stage of USD: a layer for one arm with calibrated joints and drives, the source below it.

The layer holds opinions on joints only. Bodies, meshes and references stay in the source, which it names and never changes.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import FileError
from kilter_client.twin.onto import Laid, base_in_model
from kilter_files.ground.later import np
from kilter_files.robots import NOMINAL, TOOL, local_pose, pose_matrix, split, usd_package

if TYPE_CHECKING:
    from kilter_files.ground import Floats

USD_SUFFIXES = (".usd", ".usda", ".usdc")
SCALED = 1e-6
COPIED = ("metersPerUnit", "kilogramsPerUnit", "upAxis", "defaultPrim", "timeCodesPerSecond", "framesPerSecond")


@dataclass(frozen=True)
class _Joint:
    """A joint of the twin: its prim and name, and its calibrated frame (4, 4) at zero joints in the robot's base."""

    prim: Any
    name: str
    frame: Floats


@dataclass(frozen=True)
class _Twin:
    """The exported twin: joints, nominal frames (n + 1, 4, 4), the calibrated tool (4, 4), and its notes."""

    joints: list[_Joint]
    nominal: Floats
    tool: Floats
    notes: tuple[str, ...]
    stage: Any  # whoever drops it drops its prims


@dataclass(frozen=True)
class _Found:
    """A joint of the source: its prim, the bodies it joins, and its local poses (4, 4) in them, m."""

    prim: Any
    before: str | None
    behind: str
    at_before: Floats
    at_behind: Floats


def lay_over(source: Path, twin: str, output: Path, joints: Sequence[str] = ()) -> Laid:
    """Write a layer that calibrates ``source`` for one arm.

    Args:
        source: a stage of USD with an articulation; it and what it names stay as they are.
        twin: the text of ``kilter version export --format usd``.
        output: where the layer will lie: it names the source from there.
        joints: what the source calls the robot's joints, in their order, by name or path; by default as the robot does.

    Raises:
        FileError: the source cannot be composed, has no articulation, lacks a joint, is of another arm or another zero.

    """
    pxr = usd_package()
    found = _read(twin)
    names = list(joints) or [joint.name for joint in found.joints]
    if len(names) != len(found.joints):
        message = (
            f"--joints names {len(names)} joints, the version has {len(found.joints)}: name one for each of its joints."
        )
        raise FileError(message, file=str(source))
    below = _open_stage(source)
    layer = pxr.Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths.append(str(source.resolve()))
    for name in COPIED:
        if below.HasAuthoredMetadata(name):
            layer.pseudoRoot.SetInfo(name, below.GetMetadata(name))
    stage = pxr.Usd.Stage.Open(layer)
    _Overlay(source, stage, found, names).write()
    notes = tuple(_notes(found))
    written = pxr.Sdf.Layer.CreateAnonymous(".usda")  # no stage follows it
    written.TransferContent(layer)
    written.documentation = "\n".join((f"Calibrated by Kilter, over {source.name}.", *notes))
    there = Path(os.path.relpath(source.resolve(), output.resolve().parent)).as_posix()
    written.subLayerPaths[0] = there if there.startswith(".") else f"./{there}"
    return Laid(str(written.ExportToString()), notes)


def _read(text: str) -> _Twin:
    pxr = usd_package()
    layer = pxr.Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(text)
    stage = pxr.Usd.Stage.Open(layer)
    cache = pxr.UsdGeom.XformCache()
    prims = [prim for prim in stage.Traverse() if prim.HasAttribute("kilter:number")]
    joints = []
    for prim in sorted(prims, key=lambda one: int(one.GetAttribute("kilter:number").Get())):
        joint = pxr.UsdPhysics.Joint(prim)
        body = stage.GetPrimAtPath(joint.GetBody1Rel().GetTargets()[0])
        own = pose_matrix(joint.GetLocalPos1Attr().Get(), joint.GetLocalRot1Attr().Get())
        name = str(prim.GetAttribute("kilter:joint").Get())
        joints.append(_Joint(prim, name, _in_stage(cache, body) @ own))
    tool = next(prim for prim in stage.Traverse() if prim.GetName() == TOOL)
    rows = np.array(stage.GetDefaultPrim().GetAttribute(NOMINAL).Get(), dtype=np.float64).reshape(-1, 7)
    Gf = pxr.Gf
    nominal = np.array([pose_matrix(row[:3], Gf.Quatd(*(float(v) for v in row[3:]))) for row in rows])
    return _Twin(joints, nominal, _in_stage(cache, tool), tuple(layer.documentation.splitlines()), stage)


def _in_stage(cache: Any, prim: Any) -> Floats:
    return np.array(cache.GetLocalToWorldTransform(prim), dtype=np.float64).T.copy()


def _open_stage(source: Path) -> Any:
    """Open the source."""
    pxr = usd_package()
    try:
        stage = pxr.Usd.Stage.Open(str(source))
    except pxr.Tf.ErrorException as error:
        why = str(error).strip().splitlines()[-1].strip()
        raise FileError(
            f"{source}: is not a stage of USD ({why}). Name a .usd, .usda or .usdc.", file=str(source)
        ) from error
    broken = stage.GetCompositionErrors()
    if broken:
        raise FileError(
            f"{source}: cannot be composed: {' '.join(str(broken[0]).split())} Put the file where the source names it, or take "
            "the cycle out; `usdchecker` finds the others.",
            file=str(source),
        )
    if not any(prim.HasAPI(pxr.UsdPhysics.ArticulationRootAPI) for prim in stage.Traverse()):
        raise FileError(
            f"{source}: has no articulation. Name the stage with the physics of the arm (often ..._physics.usd), or apply "
            "PhysicsArticulationRootAPI to its root.",
            file=str(source),
        )
    return stage


class _Overlay:
    """The source with the new layer on top of it, which all writing goes to."""

    def __init__(self, path: Path, stage: Any, twin: _Twin, names: Sequence[str]) -> None:
        self.pxr = usd_package()
        self.path, self.stage, self.twin, self.names = path, stage, twin, names
        self.unit = float(self.pxr.UsdGeom.GetStageMetersPerUnit(stage))
        self.kilogram = float(self.pxr.UsdPhysics.GetStageKilogramsPerUnit(stage))
        # what is inside an instance too: it is found, and refused by its name
        prims = stage.Traverse(self.pxr.Usd.TraverseInstanceProxies(self.pxr.Usd.PrimAllPrimsPredicate))
        self.all = [prim for prim in prims if prim.IsA(self.pxr.UsdPhysics.Joint)]
        self.joints = [self._joint(name, j) for j, name in enumerate(names)]

    def write(self) -> None:
        """Write joints, drives and tool."""
        twin, before, behind = self.twin, *self._bodies()
        at = [body @ joint.at_before for body, joint in zip(before, self.joints, strict=True)]
        axes = np.array([T[:3, self._axis(joint)] for T, joint in zip(at, self.joints, strict=True)])
        base = base_in_model(
            self.path, self.names, twin.nominal[:-1], np.array([T[:3, 3] for T in at]), axes, before[0]
        )
        # How what hangs on each joint goes from nominal to calibrated.
        moves = [np.eye(4)]
        for one, nominal in zip(twin.joints, twin.nominal[:-1], strict=True):
            moves.append(base @ one.frame @ np.linalg.inv(base @ nominal))
        poses = [
            [np.linalg.inv(moves[j] @ before[j]) @ moves[j + 1] @ at[j], joint.at_behind]
            for j, joint in enumerate(self.joints)
        ]
        for j in range(1, len(poses)):
            if self.joints[j].before == self.joints[j - 1].behind:
                poses[j - 1][1], poses[j][0] = split(poses[j - 1][1], poses[j][0])
        for j, (first, second) in enumerate(poses):
            self._place(self.joints[j], first, second)
            self._drive(j)
        tool = np.linalg.inv(moves[-1] @ behind[-1]) @ base @ twin.tool
        self._tool(self.joints[-1].behind, tool)

    def _joint(self, name: str, j: int) -> _Found:
        UsdPhysics = self.pxr.UsdPhysics
        moving = [
            prim for prim in self.all if prim.IsA(UsdPhysics.RevoluteJoint) or prim.IsA(UsdPhysics.PrismaticJoint)
        ]
        called = [prim for prim in moving if name in (prim.GetName(), str(prim.GetPath()))]
        there = ", ".join(prim.GetName() for prim in moving) or "none"
        if len(called) != 1:
            how = "has no joint" if not called else f"has {len(called)} joints called"
            raise self._stage_error(
                f"{how} {name!r}. It has: {there}. Name the robot's {len(self.names)} joints with --joints, in their order"
                f"{', by their paths' if called else ''}."
            )
        prim, twin = called[0], self.twin.joints[j].prim
        if prim.GetTypeName() != twin.GetTypeName():
            raise self._stage_error(
                f"joint {name!r} is a {prim.GetTypeName()}, that of the robot a {twin.GetTypeName()}: name another with "
                "--joints."
            )
        bodies = [
            rel.GetTargets() for rel in (UsdPhysics.Joint(prim).GetBody0Rel(), UsdPhysics.Joint(prim).GetBody1Rel())
        ]
        if not bodies[1]:
            raise self._stage_error(f"joint {name!r} moves no body: set its physics:body1.")
        poses = self._local(prim)
        return _Found(prim, str(bodies[0][0]) if bodies[0] else None, str(bodies[1][0]), *poses)

    def _local(self, prim: Any) -> list[Floats]:
        joint = self.pxr.UsdPhysics.Joint(prim)
        out = []
        for k in (0, 1):
            place, turn = (getattr(joint, f"GetLocal{part}{k}Attr")().Get() for part in ("Pos", "Rot"))
            T = pose_matrix(place, turn)
            T[:3, 3] *= self.unit
            out.append(T)
        return out

    def _axis(self, joint: _Found) -> int:
        return "XYZ".index(str(joint.prim.GetAttribute("physics:axis").Get() or "X"))

    def _bodies(self) -> tuple[list[Floats], list[Floats]]:
        """Poses (4, 4) of the bodies before and behind each joint, m, the joints at zero wherever the stage has them."""
        cache = self.pxr.UsdGeom.XformCache()
        before: list[Floats] = []
        behind: list[Floats] = []
        first = self.joints[0].before
        reached = {first: np.eye(4) if first is None else self._pose(cache, first)}
        for j, joint in enumerate(self.joints):
            if j:
                reached = self._add_fixed_bodies(joint.before, {self.joints[j - 1].behind: behind[-1]})
            if joint.before not in reached:
                raise self._stage_error(
                    f"joint {self.names[j]!r} hangs on {joint.before or 'the stage'}, which joint {self.names[j - 1]!r} "
                    "does not carry. Name the joints with --joints from base to tool; physics:body0 is the body nearer to "
                    "the base."
                )
            self._pose(cache, joint.behind)
            before.append(reached[joint.before])
            behind.append(before[-1] @ joint.at_before @ np.linalg.inv(joint.at_behind))
        return before, behind

    def _add_fixed_bodies(self, wanted: str | None, reached: dict[str | None, Floats]) -> dict[str | None, Floats]:
        """Bodies that hang on the reached ones by fixed joints, until ``wanted`` is among them."""
        fixed = [prim for prim in self.all if prim.IsA(self.pxr.UsdPhysics.FixedJoint)]
        while wanted not in reached:
            count = len(reached)
            for prim in fixed:
                joint = self.pxr.UsdPhysics.Joint(prim)
                ends = [
                    str(t[0]) if (t := rel.GetTargets()) else None for rel in (joint.GetBody0Rel(), joint.GetBody1Rel())
                ]
                T0, T1 = self._local(prim)
                if ends[0] in reached and ends[1] is not None:
                    reached.setdefault(ends[1], reached[ends[0]] @ T0 @ np.linalg.inv(T1))
                elif ends[1] in reached and ends[0] is not None:
                    reached.setdefault(ends[0], reached[ends[1]] @ T1 @ np.linalg.inv(T0))
            if len(reached) == count:
                break
        return reached

    def _pose(self, cache: Any, path: str) -> Floats:
        prim = self.stage.GetPrimAtPath(path)
        if not prim:
            raise self._stage_error(f"has no body {path}, which a joint names. Load the layer that defines it.")
        T = _in_stage(cache, prim)
        sizes = np.linalg.norm(T[:3, :3], axis=0)
        if np.abs(sizes - 1.0).max() > SCALED:
            raise self._stage_error(
                f"body {path} is scaled by {sizes.max():g}: local poses of joints are scaled with it. Put the scale on the "
                "meshes below the body."
            )
        T[:3, 3] *= self.unit
        return T

    def _place(self, joint: _Found, *poses: Floats) -> None:
        own, Gf = self.pxr.UsdPhysics.Joint(joint.prim), self.pxr.Gf
        if joint.prim.IsInstanceProxy():
            raise self._stage_error(
                f"joint {joint.prim.GetPath()} is inside an instance, which nothing can override. Set instanceable to false "
                "there."
            )
        for k, T in enumerate(poses):
            place, turn = local_pose(T)
            getattr(own, f"CreateLocalPos{k}Attr")().Set(Gf.Vec3f(*(v / self.unit for v in place)))
            getattr(own, f"CreateLocalRot{k}Attr")().Set(Gf.Quatf(turn[0], *turn[1:]))

    def _drive(self, j: int) -> None:
        """Stiffness and damping as the twin has them, in the units of the source; and the attributes of Kilter."""
        UsdPhysics, prim, twin = self.pxr.UsdPhysics, self.joints[j].prim, self.twin.joints[j].prim
        prismatic = prim.IsA(UsdPhysics.PrismaticJoint)
        kind = "linear" if prismatic else "angular"
        unit = self.kilogram * (1.0 if prismatic else self.unit**2)
        own, theirs = UsdPhysics.DriveAPI.Apply(prim, kind), UsdPhysics.DriveAPI(twin, kind)
        own.CreateTypeAttr().Set("force")
        own.CreateStiffnessAttr().Set(theirs.GetStiffnessAttr().Get() / unit)
        own.CreateDampingAttr().Set(theirs.GetDampingAttr().Get() / unit)
        own.CreateMaxForceAttr().Set(float("inf"))
        for attribute in twin.GetAuthoredAttributes():
            if attribute.GetName().startswith("kilter:"):
                prim.CreateAttribute(attribute.GetName(), attribute.GetTypeName()).Set(attribute.Get())

    def _tool(self, body: str, T: Floats) -> None:
        place, turn = local_pose(T)
        xform = self.pxr.UsdGeom.Xform.Define(self.stage, f"{body}/{TOOL}")
        double, Gf = self.pxr.UsdGeom.XformOp.PrecisionDouble, self.pxr.Gf
        xform.AddTranslateOp(double).Set(Gf.Vec3d(*(v / self.unit for v in place)))
        xform.AddOrientOp(double).Set(Gf.Quatd(turn[0], *turn[1:]))

    def _stage_error(self, sentence: str) -> FileError:
        return FileError(f"{self.path}: {sentence}", file=str(self.path))


def _notes(twin: _Twin) -> Iterator[str]:
    yield from (
        line for line in twin.notes if line.startswith(("Calibrated by", "In ", "Left out", "Held-out", "No measured"))
    )
    yield "Masses and the rest of the source are as they were: sag is that of its own masses."
    yield "Force limits of the drives are taken off: they would hold a joint away from where it is."
    yield "Bodies are drawn where the source has them until a simulator moves them: joints count, transforms of bodies do not."
