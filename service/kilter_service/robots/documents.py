"""What a posted robot is from now on: its chain in plain numbers, and the hashes of chain and source."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree.ElementTree import indent, tostring

from kilter_core.errors import RobotError
from kilter_service.contract.robots import RobotDocument
from kilter_service.ground.core import core_arm, core_model
from kilter_service.robots.exporters.urdf_file import new_urdf
from kilter_service.robots.importers.urdf import chain_document

if TYPE_CHECKING:
    from kilter_core.arm import Robot


class Resolved(NamedTuple):
    """A robot's chain (SI), its hash, the hash of what was posted, and what of that the chain leaves out."""

    chain: dict[str, Any]
    sha256: str
    source_sha256: str
    notes: list[str]


def resolve(posted: dict[str, Any]) -> Resolved:
    """Resolve a posted document (as stored, without nulls) to its chain.

    Raises:
        RobotError: the document cannot be an arm.

    """
    understood = core_document(posted)
    chain = core_arm.resolved_document(core_arm.robot_from_document(understood.document))
    return Resolved(chain, hash_canonical_json(chain), source_sha256(posted), understood.notes)


def source_sha256(posted: dict[str, Any]) -> str:
    """Hash what was posted: the text of a URDF, else the document."""
    if posted.get("convention") == "urdf":
        return hashlib.sha256(posted["urdf"].encode()).hexdigest()
    return hash_canonical_json(posted)


def hash_canonical_json(document: Any) -> str:
    """Hash a document by its canonical JSON: sorted keys, no spaces, numbers with all their digits."""
    return hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


SETTINGS = ("controller_compensation",)  # what a document says beside the arm
KEPT = ("gravity_m_s2", "tool", "base", "links", "payload_sigma", "load")


class CoreDocument(NamedTuple):
    """A document for core, and what of the posted one it leaves out."""

    document: dict[str, Any]
    notes: list[str]


def core_document(posted: dict[str, Any]) -> CoreDocument:
    """Convert a posted document (as stored, without nulls) to core's.

    Raises:
        RobotError: the URDF cannot be an arm.

    """
    if posted["convention"] != "urdf":
        return CoreDocument(without_settings(posted), [])
    result = chain_document(posted["urdf"], posted["base_link"], posted["tip_link"], posted["name"])
    document = dict(result.document)
    document.update((key, posted[key]) for key in KEPT if key in posted)
    mimics = dict(result.mimics)
    extras = posted.get("joints") or []
    document["joints"] = _with_extras(document["joints"], [e for e in extras if e["name"] not in mimics], list(mimics))
    document["elements"] = _with_drives(document["elements"], [e for e in extras if e["name"] in mimics], mimics)
    notes = []
    if result.held_joints:
        notes.append(f"joints outside the chain, held at zero: {', '.join(result.held_joints)}")
    return CoreDocument(document, [*notes, *result.unused])


def without_settings(posted: dict[str, Any]) -> dict[str, Any]:
    """Return what a document says of the arm: what is stored, and what its hash covers."""
    return {key: value for key, value in posted.items() if key not in SETTINGS}


def _with_drives(
    elements: list[dict[str, Any]], extras: list[dict[str, Any]], mimics: dict[str, int]
) -> list[dict[str, Any]]:
    """Let the posted mimic joints say who carries their load."""
    made = [dict(element) for element in elements]
    for extra in extras:
        more = sorted(key for key in extra if key not in ("name", "drive"))
        if more:
            raise RobotError(
                f"joints names {extra['name']!r}, a mimic joint, with {', '.join(more)}: of a mimic joint only its drive "
                "counts; give limits and gear ratios to the joint that it follows.",
                field="joints",
            )
        if "drive" in extra:
            made[mimics[extra["name"]]]["drive"] = extra["drive"]
    return made


def _with_extras(joints: list[dict[str, Any]], extras: list[dict[str, Any]], mimics: list[str]) -> list[dict[str, Any]]:
    """Let the posted joints add gear ratios and limits to those of the URDF."""
    by_name = {extra["name"]: extra for extra in extras}
    unknown = sorted(set(by_name) - {joint["name"] for joint in joints})
    if unknown:
        raise RobotError(
            f"joints names {unknown[0]!r}, which does not move in the chain. It has: "
            f"{', '.join([*(joint['name'] for joint in joints), *mimics])}.",
            field="joints",
        )
    return [{**joint, **by_name.get(joint["name"], {})} for joint in joints]


def convert(document: RobotDocument, to: str) -> dict[str, Any]:
    """Return the document of the same arm in convention ``to``.

    Raises:
        RobotError: not an arm, or one the convention cannot describe. OptionError: no such convention.

    """
    posted = document.model_dump(mode="json", exclude_none=True)
    robot = core_arm.robot_from_document(core_document(posted).document)
    made = _urdf(robot) if to == "urdf" else core_arm.robot_document(robot, to)
    return made | {key: posted[key] for key in ("source", *SETTINGS) if key in posted}


def _urdf(robot: Robot) -> dict[str, Any]:
    root = new_urdf(robot.name, core_model.Calibration.nominal(robot))
    indent(root)
    driven = [{"name": joint.name, **told} for joint in robot.joints if (told := core_arm.drive_document(joint))]
    return (
        {
            "name": robot.name,
            "convention": "urdf",
            "urdf": '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n",
            "base_link": "base_link",
            "tip_link": "flange",
            "gravity_m_s2": robot.gravity.tolist(),
            "base": core_arm.pose_document(robot.T_base),
            "tool": core_arm.pose_document(robot.T_tool),
        }
        | core_arm.load_document(robot)
        | ({"joints": driven} if driven else {})
    )
