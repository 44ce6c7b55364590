"""What `kilter server effects`, `methods`, `presets`, `columns` and `formats` list without a server.

The HTTP interface as the server describes it.

What the contract says of options that the core declares: the API process must say what they are without numpy.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import Field, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document, preset_names
from kilter_core.effects import EFFECTS, Effect
from kilter_core.gap import GapOptions
from kilter_core.identify import IdentifyOptions
from kilter_core.identify.registry import METHODS
from kilter_core.motion.effects import MOTION_EFFECTS
from kilter_service.contract.jobs.registry import KINDS
from kilter_service.ground.errors import PROBLEMS
from kilter_service.ground.settings import Settings
from kilter_service.robots.exporters.registry import FORMATS
from kilter_service.run.app import create_app
from tools.contract.interface import Document, interface_text

COLUMNS_PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "columns.md"
ROW = re.compile(r"^\| (?P<names>`.+?) \| (?P<meaning>.+) \|$", re.MULTILINE)
NEEDED = {
    "moments": "link masses", "direction": "dir1 ...", "t": "t_s", "qd": "qd1_deg_s ...",
    "base_tilt_x": "base_tilt_x_deg", "base_tilt_y": "base_tilt_y_deg",
}  # fmt: skip
PLACES = {"base": "base", "measurement": "instrument"}


def lists_text() -> str:
    """Return the client's file of lists: JSON, an entry a line."""
    lists = {
        "effects": _effects(),
        "methods": _methods(),
        "presets": _presets(),
        "columns": _columns(),
        "exports": _exports(),
        "kinds": ({"id": kind, "needs_campaigns": one.needs_campaigns} for kind, one in KINDS.items()),
    }
    entries = {name: ",\n".join(json.dumps(row, ensure_ascii=False) for row in rows) for name, rows in lists.items()}
    return "{\n" + ",\n".join(f'"{name}": [\n{rows}\n]' for name, rows in entries.items()) + "\n}\n"


def _effects() -> Iterator[dict[str, str]]:
    for kind in (one for one in EFFECTS.values() if not one.nuisance):
        needs = sorted(NEEDED.get(need, need) for need in kind.needs)
        yield {"id": kind.id, "acts_on": _place(kind), "needs": ", ".join(needs), "summary": kind.summary}
    for effect in MOTION_EFFECTS:
        needs = ["a log of torques", *sorted(one for one in effect.needs if one == "temperature")]
        yield {"id": effect.id, "acts_on": "joints", "needs": ", ".join(needs), "summary": effect.label}


def _place(kind: type[Effect]) -> str:
    if kind.at_joints:
        return "joints"
    return "workspace" if kind.empirical or kind.learned else PLACES.get(kind.stage, "whole arm")


def _methods() -> Iterator[dict[str, str]]:
    for name, method in METHODS.items():
        yield {"id": name, "summary": method.summary}


def _presets() -> Iterator[dict[str, str]]:
    for name in preset_names():
        document: dict[str, Any] = preset_document(name)
        robot = robot_from_document(document)
        masses = "with masses" if robot.has_masses else "no masses"
        yield {
            "id": name,
            "joints": str(robot.n_joints),
            "convention": document["convention"],
            "masses": masses,
            "source": document["source"],
        }


def _columns() -> Iterator[dict[str, str]]:
    """The rows of the page on columns of measurements, which says of each what it means."""
    page = COLUMNS_PAGE.read_text(encoding="utf-8").partition("\n## ")[0]
    for row in ROW.finditer(page):
        meaning = re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", row["meaning"]).replace("`", "")
        meaning = re.sub(r" See [^.]+$", "", meaning)
        yield {"columns": row["names"].replace("`", ""), "meaning": meaning}


def _exports() -> Iterator[dict[str, str]]:
    for name, form in FORMATS.items():
        yield {"id": name, "ending": f".{form.suffix}"}


def served_interface() -> Document:
    """Return the document of OpenAPI of a server without data; the version of the distribution is no part of the promise."""
    with TemporaryDirectory() as folder:
        found: dict[str, Any] = create_app(Settings(data=Path(folder))).openapi()
    found["info"]["version"] = "0"
    return found


def served_interface_text() -> str:
    """Return the text that the snapshot should have."""
    return interface_text(served_interface(), PROBLEMS)


UNITS = {
    "_nm": "N m", "_c": "degC", "_s": "s", "_m": "m", "_rad": "rad", "_kg": "kg", "_mm": "mm", "_um": "um", "_deg": "deg",
    "_percent": "%",
}  # fmt: skip
LIMITS = {"low": "ge", "above": "gt", "high": "le", "below": "lt"}
FORMS = {"tuple[tuple[float, ...], ...]": "lists", "None": "null"}


def options_data() -> str:
    """Return the options of jobs that the core declares, by kind: JSON, an option a line."""
    kinds = {"identify": IdentifyOptions, "gap": GapOptions}
    made = (f"{json.dumps(kind)}: [\n" + ",\n".join(_lines(options)) + "\n]" for kind, options in kinds.items())
    return "{\n" + ",\n".join(made) + "\n}\n"


def _lines(options: type) -> Iterator[str]:
    for one in fields(options):
        if "text" in one.metadata:
            yield json.dumps(describe_option(one), ensure_ascii=False)


def describe_option(one: Field[Any], counted: bool = False) -> dict[str, Any]:
    """Return an option with its type: numbers have the unit of their name and the limits declared, or count joints from 1."""
    said = {"name": one.name, "default": one.default, "text": one.metadata["text"]}
    forms = [part.strip() for part in str(one.type).split("|")]
    if "choices" in one.metadata:
        return said | {"choices": one.metadata["choices"]} | ({"null": True} if "None" in forms else {})
    said["forms"] = [FORMS.get(form, "list" if form.startswith("tuple") else "number") for form in forms]
    if counted:
        return said | {"number": "joint"}
    said["number"] = next((kind for kind in ("bool", "int") if kind in str(one.type)), "float")
    symbol = next((symbol for ending, symbol in UNITS.items() if one.name.endswith(ending)), None)
    limits = {LIMITS[name]: value for name, value in one.metadata.items() if name in LIMITS}
    return said | ({"unit": symbol} if symbol else {}) | ({"limits": limits} if limits else {})
