"""What the columns of tracker and CMM exports are called, and the presets of four programs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

WORDS = re.compile(
    r"^(?:measurement|measured|meas|actual|act|position|pos|coordinate|coord|point|pt|center|centre|trans|t)(?=[xyz]$)"
)
TURNED = re.compile(r"^(?:measurement|measured|meas|actual|act|rot|orientation|quaternion|quat)?(r[xyz]|q[0-3wxyz])$")
SIGMA = re.compile(r"^(?:measurement)?(?:std|stdev|stddev|sigma|rms|s)([xyz])$")
U95 = re.compile(r"^(?:u|u95|uncertainty|unc|uncert)([xyz]|mag|total|)(?:95)?$")
JOINT = re.compile(r"^(?:j|joint|axis|q)(\d{1,2})$")
ANGLES = ({"roll": "rx", "pitch": "ry", "yaw": "rz"}, {"w": "rx", "p": "ry", "r": "rz"})
QUATERNION = {"q0": "qw", "q1": "qx", "q2": "qy", "q3": "qz"}


@dataclass(frozen=True)
class Preset:
    """What a program means where its file does not say: unit of length, Euler order (None: it must be given)."""

    title: str
    length: str = "mm"
    euler: str | None = None
    names: Mapping[str, str] = field(default_factory=dict)


PRESETS: Mapping[str, Preset] = {
    "generic": Preset("any text table"),
    "leica": Preset("Leica (T-Mac: angles about the moving axes)", euler="XYZ"),
    "faro": Preset("FARO CAM2 and Insight"),
    "spatialanalyzer": Preset("SpatialAnalyzer (angles about the fixed axes)", euler="xyz"),
    "polyworks": Preset("PolyWorks", names={"measx": "x", "measy": "y", "measz": "z"}),
}


def canonical_column_name(name: str) -> str:
    """Return a column's name in small letters and digits only."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def meaning(names: Sequence[str], preset: Preset) -> dict[str, int]:
    """Return which column is x, y, z, qw ..., rx ..., sx ..., u95x ..., u95, t, temperature or q1 ...; the first wins."""
    found: dict[str, int] = {}
    known = {canonical_column_name(name) for name in names}
    for i, name in enumerate(names):
        key = preset.names.get(canonical_column_name(name)) or _column_key(canonical_column_name(name), known)
        if key:
            found.setdefault(key, i)
    return found


def _column_key(name: str, known: set[str]) -> str | None:
    for angles in ANGLES:
        if name in angles and set(angles) <= known:
            return angles[name]
    bare = WORDS.sub("", name)
    if bare in ("x", "y", "z"):
        return bare
    if match := TURNED.match(name):
        return QUATERNION.get(match[1], match[1])
    if match := SIGMA.match(name):
        return f"s{match[1]}"
    if match := U95.match(name):
        return f"u95{match[1] if match[1] in ('x', 'y', 'z') else ''}"
    if match := JOINT.match(name):
        return f"j{match[1]}"
    if name in ("temperature", "temp", "airtemperature", "measurementtemperature"):
        return "temperature"
    return "t" if name in ("t", "time", "timestamp", "elapsedtime") else None
