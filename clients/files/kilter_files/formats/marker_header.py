"""What the columns of recordings, trackers and measuring machines are called."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from kilter_files.ground.later import np
from kilter_files.ground.text_layout import TextLayout, name_and_unit
from kilter_files.ground.units import SIZES
from kilter_files.tables.recording import Recording
from kilter_files.tables.survey import SHOWN, survey

COUNTER = re.compile(r"(?:frame|sample)s?[\s_]*(?:#|no\.?|number|index|nr\.?)?\s*:?", re.I)
CLOCK = {"hour": 3600.0, "hours": 3600.0, "minute": 60.0, "minutes": 60.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3}
TIME = re.compile(r"(?:time|t|timestamp|elapsed[\s_]*time|time[\s_]*stamp)\s*:?", re.I)
PARTS = (
    re.compile(r"(?P<stem>.*?)[\s_.:]*\bq[\s_]?(?P<turn>[0owxyz])", re.I),
    re.compile(r"(?P<turned>q)(?P<turn>[0owxyz])_?(?P<stem>[a-z0-9]{0,3})", re.I),
    re.compile(r"t(?P<axis>[xyz])(?P<stem>\d*)", re.I),
    re.compile(r"(?P<axis>[XYZ])_?(?P<stem>[a-z0-9]{1,3})"),
    re.compile(r"(?P<axis>[xyz])_?(?P<stem>\d{1,3})"),
    re.compile(r"(?P<stem>.*?)[\s_.:]*(?P<axis>[xyz])", re.I),
)
RATE = re.compile(r"freq|rate|\bhz\b", re.I)
FRAMES = re.compile(r"(?:number|no\.?|nr\.?)\s*(?:of)?\s*frames", re.I)
TURNS = "wxyz"


@dataclass(frozen=True)
class MarkerColumns:
    """Column indices: ``xyz`` and ``turns`` per marker, the frame counter, and the parts of time with their factors."""

    names: tuple[str, ...]
    xyz: tuple[tuple[int, int, int], ...]
    turns: tuple[tuple[int, int, int, int], ...]
    counter: int | None
    clock: tuple[tuple[int, float], ...]
    unit: str | None
    ignored: tuple[str, ...]

    @property
    def needed_columns(self) -> list[int]:
        """Every column that is read, in the order of the file."""
        found = {i for group in (*self.xyz, *self.turns) for i in group} | {i for i, _ in self.clock}
        return sorted(found | ({self.counter} if self.counter is not None else set()))


def understand(layout: TextLayout) -> MarkerColumns:
    """Find the markers among the columns; those without all three coordinates are ignored, and named."""
    names = _with_upper_row(layout)
    counter = next((i for i, name in enumerate(names) if COUNTER.fullmatch(name)), None)
    clock = _clock(layout, names)
    used = {counter} | {i for i, _ in clock}
    found: dict[tuple[str, int], dict[str, int]] = {}
    seen: Counter[tuple[str, str]] = Counter()
    for i, name in enumerate(names):
        part = None if i in used else _parse_column_name(name)
        if part is not None:
            found.setdefault((part[0], seen[part]), {})[part[1]] = i
            seen[part] += 1
    whole = {key: parts for key, parts in found.items() if {"x", "y", "z"} <= set(parts)}
    turned = [parts for parts in whole.values() if all(f"q{t}" in parts for t in TURNS)]
    taken = {i for parts in whole.values() for i in parts.values()} | used
    units = {layout.units[parts[axis]] for parts in whole.values() for axis in "xyz"} - {None}
    return MarkerColumns(
        tuple(_label(stem, count, k) for k, (stem, count) in enumerate(whole)),
        tuple((parts["x"], parts["y"], parts["z"]) for parts in whole.values()),
        tuple((p["qw"], p["qx"], p["qy"], p["qz"]) for p in turned) if len(turned) == len(whole) else (),
        counter,
        clock,
        "/".join(sorted(str(unit) for unit in units)) or None,
        tuple(name for i, name in enumerate(names) if i not in taken and name),
    )


def is_recording(layout: TextLayout, rate_hz: float | None = None) -> bool:
    """Tell whether a text holds frames of markers and not one point per row that somebody chose to measure."""
    columns = understand(layout)
    paced = rate_hz is not None or columns.counter is not None or number_above_table(layout, RATE) is not None
    several = (
        len(columns.xyz) > 1 and len(columns.ignored) <= 2
    )  # a tracker's pose log has angles, goals, joints beside
    return bool(columns.xyz) and (paced or len(columns.clock) > 1 or (bool(columns.clock) and several))


def number_above_table(layout: TextLayout, pattern: re.Pattern[str]) -> float | None:
    """Return the number that a line above the table gives a name that matches ``pattern``."""
    for cells in layout.above:
        for i, cell in enumerate(cells):
            if not pattern.search(cell):
                continue
            numbers = re.findall(r"[-+]?\d+(?:\.\d+)?", " ".join([cell, *cells[i + 1 : i + 2]]))
            if numbers:
                return float(numbers[-1])
    return None


def unit_above(layout: TextLayout) -> str | None:
    """Return the unit a line above the table states, as ``Units: mm``."""
    for cells in layout.above:
        match = re.search(r"\bunits?\b\W*(mm|cm|m|inch|inches|metres|meters|millimet\w+)\b", " ".join(cells), re.I)
        if match:
            word = match[1].lower()
            return {"metres": "m", "meters": "m", "inches": "inch"}.get(word, "mm" if word[:3] == "mil" else word)
    return None


def _with_upper_row(layout: TextLayout) -> list[str]:
    """Names; where a row of names stands above a row of x, y, z, each coordinate gets its marker's."""
    names = list(layout.names)
    axes = [name.lower() for name in names if name.lower() in ("x", "y", "z")]
    above = layout.above[-2] if layout.header and len(layout.above) > 1 else ()
    if len(axes) < 6 or not 1 <= len(above) <= len(names) or sum(map(bool, above)) < len(axes) // 3:
        return names
    current = ""
    for i, name in enumerate(names):
        current = (above[i] if i < len(above) else "") or current
        if name.lower() in ("x", "y", "z"):
            names[i] = f"{name_and_unit(current)[0]} {name}"
    return names


def _clock(layout: TextLayout, names: Sequence[str]) -> tuple[tuple[int, float], ...]:
    parts = tuple((i, CLOCK[name.lower()]) for i, name in enumerate(names) if name.lower() in CLOCK)
    if len(parts) > 1:
        return parts
    for i, name in enumerate(names):
        if TIME.fullmatch(name):
            return ((i, SIZES["time"].get(layout.units[i] or "s", 1.0)),)
    return ()


def _parse_column_name(name: str) -> tuple[str, str] | None:
    for pattern in PARTS:
        match = pattern.fullmatch(name)
        if match:
            given = match.groupdict()
            turn = (given.get("turn") or "").lower()
            return given["stem"].strip(), f"q{turn.replace('0', 'w').replace('o', 'w')}" if turn else given[
                "axis"
            ].lower()
    return None


def _label(stem: str, count: int, k: int) -> str:
    return (stem if not count else f"{stem} {count + 1}") if stem else f"Marker_{k + 1}"


def describe_recording(recording: Recording) -> dict[str, Any]:
    """Describe a recording: its frames, each marker, and the places where it cannot be right."""
    found = survey(recording)
    markers = []
    for k, name in enumerate(recording.markers):
        seen = int(found.seen[k])
        markers.append(
            {
                "name": name,
                "seen": round(seen / max(1, found.frames), 6),
                "longest_gap_frames": int(found.longest_gap[k]),
                "low_mm": [round(float(v), 4) for v in found.low[k]] if seen else None,
                "high_mm": [round(float(v), 4) for v in found.high[k]] if seen else None,
                "noise_mm": None if np.isnan(found.noise_mm[k]) else round(float(found.noise_mm[k]), 5),
            }
        )
    place = "line" if recording.kind.endswith("csv") else "frame"
    return {
        "kind": recording.kind,
        "frames": found.frames,
        "rate_hz": recording.rate_hz,
        "duration_s": recording.duration_s,
        "markers": markers,
        "frames_without_marker": found.empty_frames,
        "notes": list(recording.notes),
        "warnings": [*recording.warnings, *found.doubts],
        "problems": [{place: row, "what": what} for row, what in found.faults[:SHOWN]]
        + ([{"what": f"{len(found.faults) - SHOWN} more of these"}] if len(found.faults) > SHOWN else []),
    }


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
