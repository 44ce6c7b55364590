"""A version as USD: calibrated joints, drives that deflect as the joints do, and attributes for the rest.

The stage is made in a process of its own: Pixar's package and its caches stay with whoever loads them, 90 MB.
"""

from __future__ import annotations

import pickle
import tempfile
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.processes import sandbox
from kilter_service.ground.processes.sandbox import Limits
from kilter_service.robots.exporters.exportable import Exportable, Written
from kilter_service.robots.exporters.mjcf.drives import Drive, drives
from kilter_service.robots.exporters.mjcf.effects import ExportedEffects, exported_effects, passive_joint_part
from kilter_service.robots.exporters.mjcf.notes import notes, of_sharpened
from kilter_service.robots.exporters.mjcf.tree import identified_axes
from kilter_service.robots.exporters.usd.stage import LEAST_MASS, Stage

CHILD = "kilter_service.robots.exporters.usd.child"
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
        ended = sandbox.run(CHILD, folder, [], LIMITS, KERNELS)
        if ended.code == 0:
            return (folder / MADE).read_text(encoding="utf-8")
    why = f"took longer than {LIMITS.seconds} s" if ended.late else f"could not be made ({ended.words.strip()[-200:]})"
    raise ServiceError(f"The stage of USD {why}: try again, or take another format.", code="usd_unavailable")
