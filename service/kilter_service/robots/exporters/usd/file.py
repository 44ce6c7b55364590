"""A version as USD: calibrated joints, drives that deflect as the joints do, and attributes for the rest."""

from __future__ import annotations

from kilter_files.ground.errors import MissingPackageError
from kilter_files.robots.usd_poses import usd_package
from kilter_service.ground.errors import ServiceError
from kilter_service.robots.exporters.exportable import Exportable, Written
from kilter_service.robots.exporters.mjcf.drives import drives
from kilter_service.robots.exporters.mjcf.effects import exported_effects, passive_joint_part
from kilter_service.robots.exporters.mjcf.notes import notes, of_sharpened
from kilter_service.robots.exporters.usd.stage import LEAST_MASS, Stage

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
    try:
        usd_package()
    except MissingPackageError as error:
        raise ServiceError(
            "USD needs its package, and this server lacks it: install it there with `pip install usd-core`, or take "
            "another format.",
            code="usd_unavailable",
        ) from error
    calibration = version.calibration
    exported = exported_effects(calibration)
    driven = drives(exported.robot, [passive_joint_part(joint) for joint in exported.form.joints])
    stage = Stage(f"{version.version.robot} {version.version.id}", calibration, exported, driven)
    held = [effect for effect in exported.in_elements if effect not in exported.beyond_drives]
    partly = [effect for effect in exported.in_both if effect not in exported.beyond_drives]
    beyond = [*exported.beyond_drives, *exported.in_step]
    placed = (
        ("In the stage", held),
        ("In the stage, and of some joints in attributes only (kilter:*), which no simulator reads by itself", partly),
        ("In attributes only (kilter:*), which no simulator reads by itself", beyond),
        ("Left out", exported.left_out),
    )
    light = (f"Bodies whose masses the robot does not state weigh {LEAST_MASS * 1e3:g} g.",) if stage.light else ()
    written = notes(version.version, calibration, placed, (*of_sharpened(exported), *_KNOWN, *light))
    head = f"Calibrated by Kilter: version {version.version.id} of robot {version.version.robot}."
    return Written(stage.text("\n".join((head, *written))), written)
