"""Factory calibrations of Universal Robots arms: the YAML that ``ur_calibration`` extracts, or the controller's own file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError, UsageError
from kilter_files.ground.later import need, yaml
from kilter_files.robots.text import read_text
from kilter_files.robots.universal_dh import extract_lists_text, holds_dh, joint_origins, read_dh

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
SIZES = ("d1", "a2", "a3", "d4", "d5", "d6")

# Nominal d1, a2, a3, d4, d5, d6 in mm, from Universal Robots' published DH tables
MODELS: Mapping[str, tuple[float, float, float, float, float, float]] = {
    "ur3": (151.9, -243.65, -213.25, 112.35, 85.35, 81.9),
    "ur5": (89.159, -425.0, -392.25, 109.15, 94.65, 82.3),
    "ur10": (127.3, -612.0, -572.3, 163.941, 115.7, 92.2),
    "ur3e": (151.85, -243.55, -213.2, 131.05, 85.35, 92.1),
    "ur5e": (162.5, -425.0, -392.2, 133.3, 99.7, 99.6),
    "ur7e": (162.5, -425.0, -392.2, 133.3, 99.7, 99.6),
    "ur10e": (180.7, -612.7, -571.55, 174.15, 119.85, 116.55),
    "ur12e": (180.7, -612.7, -571.55, 174.15, 119.85, 116.55),
    "ur16e": (180.7, -478.4, -360.0, 174.15, 119.85, 116.55),
    "ur20": (236.3, -862.0, -728.7, 201.0, 159.3, 154.3),
    "ur30": (236.3, -637.0, -503.7, 201.0, 159.3, 154.3),
}
# Factory calibrations stay within about 2 mm of the table; the nearest two models differ by 10 mm in one length.
TOLERANCE_MM = 4.0
LIMIT_DEG = 360.0


def read_universal(path: Path, model: str | None, name: str) -> dict[str, Any]:
    """Return a chain document with the calibrated joint origins.

    Raises:
        FileError: no such file, or of another model than ``model``; the message says which one it is.
        UsageError: no model, or one that is not known.
        MissingPackageError: PyYAML is not installed.

    """
    if model is None or model.lower() not in MODELS:
        said = "needs --model" if model is None else f"--model {model}: is not known"
        raise UsageError(f"{path.name}: {said}. Known are {', '.join(MODELS)}.")
    text, flange = read_text(path), (0.0,) * 6
    document = None if holds_dh(text) else _document(path, text)
    text = text if document is None else extract_lists_text(document)
    checked = f"checked to be a {model.upper()}"
    if holds_dh(text):
        table, adds = read_dh(path, text, MODELS[model.lower()])
        placed, flange = joint_origins(table, path)
        origins: Mapping[str, tuple[float, ...]] = dict(zip(LINKS, placed, strict=True))
        checked = f"added to the table of a {model.upper()}" if adds else checked
    else:
        origins, adds = _origins(path, document), False
    if not adds:  # what is added to any table fits any
        refuse_other_model(path, model.lower(), sizes(origins))
    elements: list[dict[str, Any]] = []
    for joint, link in zip(JOINTS, LINKS, strict=True):
        elements += _elements(link, origins[link])
        elements += [{"joint": joint, "axis": "Rz"}]
    elements += _elements("flange", flange) if any(flange) else []
    return {
        "name": name,
        "convention": "chain",
        "source": f"factory calibration {path.name}, {checked}",
        "joints": [{"name": joint, "limits_deg": [-LIMIT_DEG, LIMIT_DEG]} for joint in JOINTS],
        "elements": elements,
    }


def _elements(link: str, origin: Sequence[float]) -> list[dict[str, Any]]:
    x, y, z, roll, pitch, yaw = origin
    steps = (("x", "Tx", x * 1e3), ("y", "Ty", y * 1e3), ("z", "Tz", z * 1e3))
    turns = (("yaw", "Rz", yaw), ("pitch", "Ry", pitch), ("roll", "Rx", roll))
    placed = [{"name": f"{link}_{k}", "axis": axis, "value": value} for k, axis, value in steps]
    return placed + [{"name": f"{link}_{k}", "axis": axis, "value": math.degrees(value)} for k, axis, value in turns]


def sizes(origins: Mapping[str, tuple[float, ...]]) -> tuple[float, ...]:
    """Return the six lengths (mm) of the DH table that the joint origins show."""
    x, y, z = ({link: values[k] * 1e3 for link, values in origins.items()} for k in range(3))
    return z["shoulder"], x["forearm"], x["wrist_1"], z["wrist_1"], -y["wrist_2"], y["wrist_3"]


def refuse_other_model(path: Path, model: str, found: tuple[float, ...]) -> None:
    """Compare the lengths with the tables of the whole family.

    Raises:
        FileError: they are not those of ``model``.

    """
    gaps = {name: max(abs(a - b) for a, b in zip(found, table, strict=True)) for name, table in MODELS.items()}
    # A calibrated frame may be rotated by 180 degrees about x; lengths then agree in size.
    turned = {
        name: max(abs(abs(a) - abs(b)) for a, b in zip(found, table, strict=True)) for name, table in MODELS.items()
    }
    if min(gaps[model], turned[model]) <= TOLERANCE_MM:
        return
    k = max(range(6), key=lambda k: abs(abs(found[k]) - abs(MODELS[model][k])))
    nearest = min(turned, key=lambda other: turned[other])
    same = " or ".join(name.upper() for name in MODELS if turned[name] == turned[nearest])
    guess = f"It is a {same}." if turned[nearest] <= TOLERANCE_MM else "It is not one of the models that Kilter knows."
    raise FileError(
        f"{path}: is not a {model.upper()}: {SIZES[k]} is {abs(found[k]):.1f} mm, a {model.upper()} has "
        f"{abs(MODELS[model][k]):.1f}. {guess}",
        file=str(path),
        model=model,
        nearest=nearest,
    )


def _document(path: Path, text: str) -> Any:
    need(f"{path}: YAML files need", "pyyaml", "yaml")
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise FileError(f"{path}: is not YAML ({error}).", file=str(path)) from error


def _origins(path: Path, document: Any) -> dict[str, tuple[float, ...]]:
    kinematics = document.get("kinematics") if isinstance(document, dict) else None
    if not isinstance(kinematics, dict):
        raise FileError(
            f"{path}: has no 'kinematics'. Extract it with ur_calibration, or take the controller's calibration.conf.",
            file=str(path),
        )
    return {link: _origin(path, link, kinematics.get(link)) for link in LINKS}


def _origin(path: Path, link: str, values: Any) -> tuple[float, ...]:
    if not isinstance(values, dict):
        raise FileError(f"{path}: kinematics.{link} is missing.", file=str(path), place=link)
    for key in KEYS:
        value = values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise FileError(f"{path}: kinematics.{link}.{key} is {value!r}, not a number.", file=str(path), place=link)
    return tuple(float(values[key]) for key in KEYS)
