"""Any robot file as a robot document, by its ending."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from kilter_files.ground.errors import FileError, UsageError, did_you_mean
from kilter_files.robots.exported import read_text
from kilter_files.robots.mesh_files import uncoupled_urdf
from kilter_files.robots.table import read_table
from kilter_files.robots.universal import holds_dh, read_universal

Item = dict[str, Any]

DRIVES = ("linkage", "controller", "series")
PARALLEL = math.sin(math.radians(1.0))


def apply_joint_coupling(document: Item, turned: Sequence[str], follows: Sequence[str]) -> Item:
    """Return the document as a chain in which ``turned`` joints count backwards and each "j3=j2" is uncoupled.

    "j3=j2" is for arms whose third joint is read against the horizontal (FANUC, parallelogram arms): when j2 moves,
    the forearm keeps its orientation in space, so j3's axis is rotated back by j2. "j3=j2:linkage" says besides who carries
    the load on that axis: one of :data:`DRIVES`.

    In a URDF an axis that mimics j2 is put before j3.

    Raises:
        UsageError: a joint that is not there, or a document that cannot say it.

    """
    for pair in follows:
        if not all(part.strip() for part in pair.partition("=")):
            raise UsageError(f'--follows {pair}: is not a pair of joints. Give the one that follows first, as "j3=j2".')
    if document.get("convention") == "urdf" and not turned:
        return {**document, "urdf": _uncouple_urdf_joints(document["urdf"], follows)}
    if document.get("convention") in ("dh", "mdh"):
        document = _as_chain(document)
    if document.get("convention") != "chain":
        raise UsageError("--turned needs a table or a chain: in a URDF, reverse the axis of the joint instead.")
    elements = [dict(element) for element in document["elements"]]
    for name in turned:
        for element in _joint_elements(elements, name):
            element["ratio"] = -float(element.get("ratio", 1.0))
    for pair in follows:
        follower, _, rest = pair.partition("=")
        _uncouple(elements, follower.strip(), *_leader(pair, rest.strip(), elements))
    return {**document, "elements": elements}


def _uncouple_urdf_joints(urdf: str, follows: Sequence[str]) -> str:
    for pair in follows:
        follower, _, leader = (part.strip() for part in pair.partition("="))
        if leader.rpartition(":")[2].strip() in DRIVES and f'"{leader}"' not in urdf:
            raise UsageError(
                f"--follows {pair}: a URDF does not say who carries the load. Leave {leader.rpartition(':')[2]} out, or make "
                "a chain of the file first with `kilter robot convert`."
            )
        urdf = uncoupled_urdf(urdf, follower, leader)
    return urdf


def _joint_elements(elements: list[Item], name: str) -> list[Item]:
    found = [element for element in elements if element.get("joint") == name]
    if not found:
        known = list(dict.fromkeys(str(element["joint"]) for element in elements if element.get("joint")))
        raise UsageError(f"There is no joint {name!r}{did_you_mean(name, known)}. There are: {', '.join(known)}.")
    return found


def _leader(pair: str, text: str, elements: list[Item]) -> tuple[str, str | None]:
    """Return the joint that is followed, and who carries the load of the axis in between where that is said."""
    leader, colon, drive = text.rpartition(":")
    if not colon or any(element.get("joint") == text for element in elements):
        return text, None
    if drive.strip() not in DRIVES:
        near = did_you_mean(drive.strip(), DRIVES)
        raise UsageError(f"--follows {pair}: drive is {drive.strip()!r}{near}. Give {', '.join(DRIVES)}.")
    return leader.strip(), drive.strip()


def _uncouple(elements: list[Item], follower: str, leader: str, drive: str | None) -> None:
    """Rotate the follower's axis back by the leader; their axes must be parallel."""
    first, second = _joint_elements(elements, leader)[0], _joint_elements(elements, follower)[0]
    start, end = elements.index(first), elements.index(second)
    between = elements[start + 1 : end]
    turns = [e for e in between if str(e["axis"]).startswith("R") and (e.get("joint") or e.get("value"))]
    flat = first["axis"] == second["axis"] and all(
        abs(math.remainder(float(e.get("value") or 0.0), 180.0)) < 1.0 and not e.get("joint") for e in turns
    )
    if start >= end or not flat:
        raise UsageError(
            f"--follows {follower}={leader}: the axis of {follower} must come after and be parallel to {leader}'s."
        )
    halves = sum(1 for e in turns if e["axis"] != first["axis"] and abs(float(e["value"])) > 90.0)
    ratio = -float(first.get("ratio", 1.0)) * (-1.0) ** halves
    said = {} if drive is None else {"drive": drive}
    elements.insert(end, {"joint": leader, "axis": second["axis"], "ratio": ratio, "fixed": True, **said})


def _as_chain(document: Item) -> Item:
    if document.get("links"):
        raise UsageError(
            "--turned and --follows make a chain of the table, in which links have other frames: leave links out."
        )
    dh = document["convention"] == "dh"
    names = [joint["name"] for joint in document["joints"]]
    elements: list[Item] = []
    for number, (name, row) in enumerate(zip(names, document["rows"], strict=True), 1):
        inner = number < len(names) if dh else number > 1
        joint, link = _joint(name, number, row, dh), _link(number, row, dh, inner)
        elements += [*joint, *link] if dh else [*link, *joint]
    kept = {key: value for key, value in document.items() if key not in ("rows", "convention", "links")}
    return {**kept, "convention": "chain", "elements": elements}


def _joint(name: str, number: int, row: Item, dh: bool) -> list[Item]:
    prismatic = row.get("type") == "prismatic"
    theta, d = row.get("theta_offset_deg") or 0.0, row.get("d_mm", 0.0)
    turn = {"axis": "Rz", "name": f"theta_offset_{number}", "value": theta}
    shift = {"axis": "Tz", "name": f"d_{number}", "value": d or 0.0}
    (shift if prismatic else turn)["joint"] = name
    steps = [shift, turn] if dh else [turn, shift]
    return steps if d is not None else [turn]


def _link(number: int, row: Item, dh: bool, inner: bool) -> list[Item]:
    alpha = float(row.get("alpha_deg") or 0.0)
    turn = {"axis": "Rx", "name": f"alpha_{number}", "value": alpha}
    shift = {"axis": "Tx", "name": f"a_{number}", "value": row.get("a_mm", 0.0)}
    # As the server does for tables: parallel axes need Hayati's small rotation to stay identifiable.
    parallel = inner and abs(math.sin(math.radians(alpha))) < PARALLEL
    beta = row.get("beta_deg")
    tilt = [{"axis": "Ry", "name": f"beta_{number}", "value": beta or 0.0}] if beta is not None or parallel else []
    return [shift, turn, *tilt] if dh else [turn, *tilt, shift]


JOINTS = 5  # the sixth motor is the gripper
SEGMENTS = 4
MOTOR = re.compile(r"\[MOT\[(\d+)\]\]")
HEADING = re.compile(r"\[([A-Za-z]\w*)\]")
ENTRY = re.compile(r'([\w\[\]]+)\s*=\s*"([^"]*)"\s*;')
SEGMENT = re.compile(r"segment\[?(\d)\]?", re.IGNORECASE)


def read_katana(path: Path, name: str) -> dict[str, Any]:
    """Return a chain document whose joints are read as KNI reads them: angles between angleOffset and its range.

    Raises:
        FileError: a motor or a segment is missing, or a value is not a number.

    """
    motors, segments = _entries(path)
    lengths = [segments.get(k) for k in range(1, SEGMENTS + 1)]
    if any(length is None for length in lengths):
        missing = [f"segment{k}" for k in range(1, SEGMENTS + 1) if k not in segments]
        raise FileError(f"{path}: {', '.join(missing)} is missing: is this a KNI configuration?", file=str(path))
    return {
        "name": name,
        "convention": "chain",
        "source": f"KNI configuration {path.name}; joints as KNI counts them",
        "joints": [{"name": f"j{k + 1}", "limits_deg": _limits(path, motors, k)} for k in range(JOINTS)],
        "elements": _elements([float(length or 0.0) for length in lengths]),
    }


def _elements(lengths: list[float]) -> list[dict[str, Any]]:
    """KNI's direct kinematics (6M180): upright at 90, 180, 180 deg, the wrist counting backwards.

    Between the parallel axes 2, 3 and 4 stand small tilts about x and z, which a calibration needs.
    """
    upper, fore, wrist, end = lengths
    return [
        {"joint": "j1", "axis": "Rz"},
        {"axis": "Rx", "name": "alpha_2", "value": 0.0},
        {"joint": "j2", "axis": "Ry", "value": -90.0},
        {"axis": "Tz", "name": "segment_1", "value": upper},
        {"axis": "Rx", "name": "alpha_3", "value": 0.0},
        {"axis": "Rz", "name": "beta_3", "value": 0.0},
        {"joint": "j3", "axis": "Ry", "value": -180.0},
        {"axis": "Tz", "name": "segment_2", "value": fore},
        {"axis": "Rx", "name": "alpha_4", "value": 0.0},
        {"axis": "Rz", "name": "beta_4", "value": 0.0},
        {"joint": "j4", "axis": "Ry", "ratio": -1.0, "value": 180.0},
        {"axis": "Tz", "name": "segment_3", "value": wrist},
        {"axis": "Rx", "name": "alpha_5", "value": 0.0},
        {"joint": "j5", "axis": "Rz", "ratio": -1.0, "value": 90.0},
        {"axis": "Tz", "name": "segment_4", "value": end},
    ]


def _entries(path: Path) -> tuple[dict[int, dict[str, str]], dict[int, float]]:
    """Return the entries of each motor, and the segments (mm)."""
    motors: dict[int, dict[str, str]] = {}
    segments: dict[int, float] = {}
    motor: int | None = None
    for number, line in enumerate(read_text(path).splitlines(), 1):
        text = line.partition("#")[0].strip()
        if match := MOTOR.search(text):
            motor = int(match[1])
        elif (heading := HEADING.fullmatch(text)) and heading[1].upper().startswith(("END", "EFF", "KATANA")):
            motor = None
        elif match := ENTRY.search(text):
            if motor is not None:
                motors.setdefault(motor, {})[match[1]] = match[2]
            elif segment := SEGMENT.fullmatch(match[1]):
                # KNI counts from 1 in segment1 and from 0 in segment[0].
                segments[int(segment[1]) + ("[" in match[1])] = _number(path, number, match[1], match[2])
    if not motors:
        raise FileError(f"{path}: has no [MOT[0]]: is this a KNI configuration?", file=str(path))
    return motors, segments


def _limits(path: Path, motors: dict[int, dict[str, str]], k: int) -> list[float]:
    entries = motors.get(k, {})
    missing = [key for key in ("angleOffset", "angleRange") if key not in entries]
    if missing:
        raise FileError(
            f"{path}: motor {k} ([MOT[{k}]]) lacks {', '.join(missing)}.", file=str(path), place=f"MOT[{k}]"
        )
    start, span = (_number(path, 0, f"MOT[{k}] {key}", entries[key]) for key in ("angleOffset", "angleRange"))
    return sorted((start, start + span))


def _number(path: Path, line: int, key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        where = f", line {line}" if line else ""
        raise FileError(f"{path}{where}: {key} is {text!r}, not a number.", file=str(path), place=key)
    return value


FREE = ("floating", "planar")  # types of joints that hold nothing


def find_arm_links(path: Path, text: str, base_link: str | None, tip_link: str | None) -> tuple[str, str]:
    """Return the first and the last link of the arm; what was not said is taken where the file leaves no choice.

    A base link is left no choice by the only link that hangs on no other, a tip link by the only one on which none hangs.

    Raises:
        FileError: the file is not XML.
        UsageError: the file leaves a choice; the message lists the links to choose from.

    """
    if base_link and tip_link:  # the server reads the tree and knows more of it
        return base_link, tip_link
    first, last = _ends(path, text)
    asked = [
        f"{option} ({', '.join(links) if links else 'none was found'})"
        for option, said, links in (("--base-link", base_link, first), ("--tip-link", tip_link, last))
        if not said and len(links) != 1
    ]
    if asked:
        raise UsageError(
            f"{path.name} holds more than one chain of links: say which is the arm by {' and '.join(asked)}."
        )
    return base_link or first[0], tip_link or last[0]


def _ends(path: Path, text: str) -> tuple[list[str], list[str]]:
    """Return the links that hang on no other, and those on which none hangs, in the order of the file.

    Floating and planar joints hold nothing, so an arm does not end at a link that only they join to others.
    """
    if "<!DOCTYPE" in text:
        raise FileError(f"{path}: a URDF has no document type: take the <!DOCTYPE> out.", file=str(path))
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - without a document type there are no entities
    except ElementTree.ParseError as error:
        remedy = "If it is a .xacro, expand it first: xacro FILE > arm.urdf."
        raise FileError(f"{path}: is not XML ({error}). {remedy}", file=str(path)) from error
    links = [link.get("name", "") for link in root.findall("link")]
    joints = [joint for joint in root.findall("joint") if joint.get("type") not in FREE]
    held = {end.get("link") for joint in joints for end in joint.findall("child")}
    holding = {end.get("link") for joint in joints for end in joint.findall("parent")}
    first = [link for link in links if link in holding and link not in held]
    return first, [link for link in links if link in held and link not in holding]


URDF = (".urdf", ".xml")
TABLES = (".csv", ".tsv", ".txt", ".xlsx")
UR = (".yaml", ".yml", ".conf")
KATANA = (".cfg",)
MOST_LETTERS = 100_000
NEEDED = {
    "convention": (TABLES, "--convention belongs to a table (.csv, .xlsx)."),
    "model": (UR, "--model belongs to a calibration of Universal Robots (.yaml, calibration.conf)."),
    "base_link": (URDF, "--base-link belongs to a .urdf file."),
    "tip_link": (URDF, "--tip-link belongs to a .urdf file."),
}


@dataclass(frozen=True)
class Described:
    """What the file does not say itself: the robot's name, the links of a URDF, a table's convention, a UR's model.

    ``turned`` are joints whose controller counts the other way; ``follows`` are pairs "j3=j2" of joints of which the
    first is read against the horizontal, not against the link before; "j3=j2:linkage" says who carries its load.
    """

    name: str | None = None
    base_link: str | None = None
    tip_link: str | None = None
    convention: str | None = None
    model: str | None = None
    turned: Sequence[str] = ()
    follows: Sequence[str] = ()


def read_robot(path: Path, described: Described) -> dict[str, Any]:
    """Return the robot document of a file.

    Raises:
        FileError: the file is not what it should be; the message names place and remedy.
        UsageError: something is missing that the file does not say, or does not belong to it.
        MissingPackageError: the format needs the extra ``files``.

    """
    ending = _ending(path)
    for field, (endings, message) in NEEDED.items():
        if getattr(described, field) and ending not in endings:
            raise UsageError(message)
    return _apply_description(_read(path, ending, described), described)


def _ending(path: Path) -> str:
    """The ending of a file; a controller's calibration is known by what it holds, too."""
    ending = path.suffix.lower()
    if (
        ending in (".txt", ".cfg", "")
        and path.is_file()
        and holds_dh(path.read_text(encoding="latin-1")[:MOST_LETTERS])
    ):
        return ".conf"
    return ending


def described_document(document: Mapping[str, Any], described: Described) -> dict[str, Any]:
    """Return a robot document with what was said of it beside it: its name, and how its controller counts joints.

    Raises:
        UsageError: a joint that is not there, or what belongs to another kind of file.

    """
    for field, (_, message) in NEEDED.items():
        if getattr(described, field):
            raise UsageError(f"{message} A document says it itself.")
    return _apply_description(dict(document), described)


def _apply_description(document: dict[str, Any], described: Described) -> dict[str, Any]:
    if described.turned or described.follows:
        document = apply_joint_coupling(document, described.turned, described.follows)
    return {**document, "name": described.name} if described.name else document


def _read(path: Path, ending: str, described: Described) -> dict[str, Any]:
    if ending in URDF:
        return _urdf(path, described)
    if ending in TABLES:
        return read_table(path, described.convention, _name(path, described))
    if ending in UR:
        return read_universal(path, described.model, _name(path, described))
    if ending in KATANA:
        return read_katana(path, _name(path, described))
    return _json(path)


def _name(path: Path, described: Described) -> str:
    if not described.name:
        raise UsageError(f"{path.name} does not name the robot: give it a name with --name.")
    return described.name


def _urdf(path: Path, described: Described) -> dict[str, Any]:
    name, text = _name(path, described), read_text(path)
    base_link, tip_link = find_arm_links(path, text, described.base_link, described.tip_link)
    return {"name": name, "convention": "urdf", "urdf": text, "base_link": base_link, "tip_link": tip_link}


def _json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(read_text(path))
    except ValueError as error:
        raise FileError(f"{path}: is not JSON ({error}).", file=str(path)) from error
    if not isinstance(document, dict):
        raise FileError(f"{path}: is not a JSON object. Describe one robot, see the robots reference.", file=str(path))
    return document
