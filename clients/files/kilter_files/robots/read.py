"""Any robot file as a robot document, by its ending."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError, UsageError
from kilter_files.robots.coupling import apply_joint_coupling
from kilter_files.robots.katana import read_katana
from kilter_files.robots.table import read_table
from kilter_files.robots.text import read_text
from kilter_files.robots.universal import read_universal
from kilter_files.robots.universal_dh import holds_dh
from kilter_files.robots.urdf_chain import find_arm_links

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
