"""Factory calibrations of Universal Robots arms: the YAML that ``ur_calibration`` extracts, or the controller's own file.

Axes 2, 3 and 4 are nearly parallel, so the common normals of a calibrated table lie metres away and point elsewhere.
What a joint does not feel, a displacement along its axis and a rotation about it, is handed on to the next link: frames
stay near the nominal ones, and so do their small errors.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError, UsageError
from kilter_files.ground.later import need, np, yaml
from kilter_files.robots.exported import read_text

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


LIST = re.compile(r"^[ \t]*((?:delta|dh)_(?:theta|a|d|alpha))[ \t]*[=:][ \t]*\[([^\]]*)\]", re.M | re.I)
ALPHAS = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
DELTA, WHOLE = "delta_", "dh_"
ROWS = ("theta", "a", "d", "alpha")
Origin = tuple[float, float, float, float, float, float]
Table = Mapping[str, tuple[float, ...]]


def holds_dh(text: str) -> bool:
    """Say whether a text is such a table."""
    found = {match[1].lower() for match in LIST.finditer(text)}
    return any({f"{stem}a", f"{stem}d", f"{stem}alpha"} <= found for stem in (DELTA, WHOLE))


def extract_lists_text(document: Any) -> str:
    """Return the lists of such a table in a YAML document, wherever they are, as text; empty: there are none."""
    if not isinstance(document, dict):
        return ""
    own = [f"{key} = {value}" for key, value in document.items() if isinstance(value, list)]
    return "\n".join([*own, *filter(None, map(extract_lists_text, document.values()))])


def read_dh(path: Path, text: str, nominal_mm: Sequence[float]) -> tuple[Table, bool]:
    """Return theta, a, d, alpha (rad, m) of six joints, and whether they were added to a nominal table.

    ``nominal_mm`` are d1, a2, a3, d4, d5, d6 of that table.

    Raises:
        FileError: a list is missing, is not of six numbers, or stands there twice.

    """
    found: dict[str, tuple[float, ...]] = {}
    for match in LIST.finditer(text):
        name = match[1].lower()
        if name in found:
            raise FileError(f"{path}: {name} stands there twice. Keep the one of this arm.", file=str(path), place=name)
        found[name] = _six(path, name, match[2])
    stem = DELTA if f"{DELTA}a" in found else WHOLE
    for row in ROWS:
        name = f"{stem}{row}"
        if name not in found and row != "theta":
            raise FileError(
                f"{path}: has no {name}. Copy the whole file from the controller.", file=str(path), place=name
            )
        found.setdefault(name, (0.0,) * 6)
    if stem == WHOLE:
        return {row: found[f"{stem}{row}"] for row in ROWS}, False
    d1, a2, a3, d4, d5, d6 = (value / 1e3 for value in nominal_mm)
    nominal = {"theta": (0.0,) * 6, "a": (0.0, a2, a3, 0.0, 0.0, 0.0), "d": (d1, 0.0, 0.0, d4, d5, d6), "alpha": ALPHAS}
    added = {row: tuple(a + b for a, b in zip(nominal[row], found[f"{stem}{row}"], strict=True)) for row in ROWS}
    return added, True


def joint_origins(table: Table, path: Path) -> tuple[list[Origin], Origin]:
    """Return the origin of each joint (x, y, z m, roll, pitch, yaw rad) seen from the link before it, and the flange's.

    Raises:
        MissingPackageError: numpy is not installed.

    """
    need(f"{path}: the calibration of a UR needs", "numpy")
    theta, a, d, alpha = (table[row] for row in ROWS)
    steps = [_along_x(a[k - 1], alpha[k - 1]) if k else np.eye(4) for k in range(6)]
    steps = [step @ _about_z(theta[k], d[k]) for k, step in enumerate(steps)]
    for k in (1, 2):  # nothing about or along an axis that the next one is parallel to
        turn = math.atan2(steps[k][1, 0], steps[k][0, 0]) if k == 2 else theta[1]
        rest = steps[k] @ _about_z(-turn, 0.0)
        way = float(rest[2, 3] / rest[2, 2]) if k == 2 else d[1]
        steps[k] = rest @ _about_z(0.0, -way)
        steps[k + 1] = _about_z(turn, way) @ steps[k + 1]
    return [_origin_of_transform(step) for step in steps], _origin_of_transform(_along_x(a[5], alpha[5]))


def _six(path: Path, name: str, said: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in said.replace("\n", " ").split(","))
    except ValueError:
        values = ()
    if len(values) != 6 or not all(map(math.isfinite, values)):
        raise FileError(f"{path}: {name} is not six numbers. Copy the file again.", file=str(path), place=name)
    return values


def _about_z(angle: float, way: float) -> Any:
    T = np.eye(4)
    c, s = math.cos(angle), math.sin(angle)
    T[:2, :2], T[2, 3] = [[c, -s], [s, c]], way
    return T


def _along_x(way: float, angle: float) -> Any:
    T = np.eye(4)
    c, s = math.cos(angle), math.sin(angle)
    T[1:3, 1:3], T[0, 3] = [[c, -s], [s, c]], way
    return T


def _origin_of_transform(T: Any) -> Origin:
    roll, pitch = math.atan2(T[2, 1], T[2, 2]), math.atan2(-T[2, 0], math.hypot(T[2, 1], T[2, 2]))
    yaw = math.atan2(T[1, 0], T[0, 0])
    x, y, z = (float(value) for value in T[:3, 3])
    return x, y, z, roll, pitch, yaw
