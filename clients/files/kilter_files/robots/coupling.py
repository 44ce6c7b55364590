"""Joints as controllers count them: reversed, or measured against the horizontal instead of the link before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from kilter_files.ground.errors import UsageError
from kilter_files.ground.names import did_you_mean
from kilter_files.robots.urdf_coupling import uncoupled_urdf

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
