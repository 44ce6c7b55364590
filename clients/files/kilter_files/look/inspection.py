"""How a file is read, before anything is sent: one document for people and programs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kilter_files.formats.joints.bag import is_bag
from kilter_files.formats.joints.joint_log import LogHints, read_joint_log
from kilter_files.formats.logs.ballbar import analysed, is_ballbar, read_ballbar
from kilter_files.formats.logs.inclinometer import read_inclinometer, tilts_of
from kilter_files.formats.points.tracker_text import read_tracker
from kilter_files.formats.programs.targets import dialect_of
from kilter_files.formats.recordings.marker_header import RATE, told, understand
from kilter_files.formats.recordings.opening import kind_of, open_recording
from kilter_files.formats.recordings.polaris_long import long_columns
from kilter_files.ground.errors import FileError
from kilter_files.ground.text_layout import TextLayout, sniff
from kilter_files.ground.units import unit_of
from kilter_files.look.draft import has_joints
from kilter_files.look.inspection_joints import column, describe_bag, describe_log
from kilter_files.look.inspection_table import describe_table, lines_in_cells
from kilter_files.tables.joint_log import JOINT
from kilter_files.tables.recording import Recording
from kilter_files.tables.survey import SHOWN, survey

Document = dict[str, Any]


@dataclass(frozen=True)
class Hints:
    """What the person says of a file that does not say it itself."""

    rate_hz: float | None = None
    allow_cut: bool = False
    preset: str = "generic"
    euler: str | None = None
    unit: str | None = None
    log: LogHints = field(default_factory=LogHints)


def inspect(path: Path, hints: Hints = Hints()) -> Document:
    """Understand a file by its content; ``problems`` say what would be refused, ``warnings`` what to look at.

    Raises:
        FileError: the file cannot be read at all, with place and remedy.

    """
    kind = "bag" if is_bag(path) else kind_of(path)
    if kind in ("c3d", "n3d"):
        found = _recording(open_recording(path, hints.rate_hz, hints.allow_cut, hints.unit))
    else:
        found = {"tdms": _tdms, "mat": _mat, "parquet": _parquet, "text": _text, "bag": _bag, "xlsx": _table}[kind](
            path, hints
        )
    known = {"kind": kind, "problems": [], "warnings": [], "notes": []}
    size = path.stat().st_size if path.is_file() else sum(file.stat().st_size for file in path.iterdir())
    return {"file": str(path), "size_bytes": size} | known | found


def _bag(path: Path, hints: Hints) -> Document:
    return describe_bag(path, hints.log)


def _text(path: Path, hints: Hints) -> Document:
    if dialect_of(path) is not None:
        return describe_log(read_joint_log(path))
    if lines_in_cells(path):
        return describe_table(path)
    layout = sniff(path)
    shape = {"layout": _layout(layout)}
    contract = [name for name in _full_names(layout) if unit_of(name) is not None]
    if len(contract) == len(layout.names):
        return _contract(path, contract) | shape
    if is_ballbar(layout):
        return _ballbar(path) | shape
    if tilts_of(layout) and not understand(layout).xyz:
        return _inclinometer(path, hints) | shape
    if is_recording(layout, hints.rate_hz):
        return _recording(open_recording(path, hints.rate_hz, hints.allow_cut, hints.unit)) | shape
    if hints.preset == "generic" and hints.euler is None and _with_joints(path):
        return describe_table(path) | shape
    table = read_tracker(path, hints.preset, hints.euler)
    columns = [column(name, unit_of(name), np.array(values)) for name, values in table.columns.items()]
    return shape | {
        "kind": "tracker-text",
        "rows": len(table),
        "columns": columns,
        "notes": table.notes,
        "warnings": table.warnings + _alike(table.columns),
    }


def _with_joints(path: Path) -> bool:
    """Whether a table has joints beside the points: a reader of points would leave them out, and a draft does not."""
    try:
        return has_joints(path)
    except FileError:
        return False


def _table(path: Path, hints: Hints) -> Document:
    return describe_table(path)


def is_contract(path: Path) -> bool:
    """Tell whether every column of a text is a contract column."""
    layout = sniff(path)
    return all(unit_of(name) is not None for name in _full_names(layout))


def is_recording(layout: TextLayout, rate_hz: float | None = None) -> bool:
    """Tell whether a text holds frames of markers and not one point per row that somebody chose to measure."""
    if long_columns(layout) is not None:
        return True
    columns = understand(layout)
    paced = rate_hz is not None or columns.counter is not None or told(layout, RATE) is not None
    several = (
        len(columns.xyz) > 1 and len(columns.ignored) <= 2
    )  # a tracker's pose log has angles, goals, joints beside
    return bool(columns.xyz) and (paced or len(columns.clock) > 1 or (bool(columns.clock) and several))


def _full_names(layout: TextLayout) -> list[str]:
    """Names with the units that were taken off them, as the contract writes both in one."""
    told = zip(layout.names, layout.units, strict=True)
    return [f"{name}_{(unit or '').lower()}".rstrip("_") for name, unit in told]


def _layout(layout: TextLayout) -> Document:
    told = zip(layout.names, layout.units, strict=True)
    return {
        "encoding": layout.encoding,
        "delimiter": layout.delimiter,
        "decimal": layout.decimal,
        "first_row_in_line": layout.first_line,
        "header": layout.header,
        "columns": [{"name": name, "unit": unit} for name, unit in told],
    }


def _recording(recording: Recording) -> Document:
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


def _contract(path: Path, names: list[str]) -> Document:
    if not any(JOINT.fullmatch(name) for name in names):
        return {"kind": "contract-columns", "columns": [{"name": name} for name in names], "warnings": ["no joints"]}
    found = describe_log(read_joint_log(path))
    measured = any(name in names for name in ("x_mm", "x_m", "m1x_mm", "m1x_m", "link1_deg", "link1_rad"))
    return found | ({"kind": "contract-columns", "notes": ["ready for kilter upload"]} if measured else {})


def _inclinometer(path: Path, hints: Hints) -> Document:
    found = read_inclinometer(path, hints.unit)
    columns = [column(name, unit_of(name), values) for name, values in found.columns.items()]
    rows = len(found.columns["t_s"])
    told = {"notes": list(found.notes), "warnings": list(found.warnings)}
    return {"kind": "inclinometer", "rows": rows, "columns": columns} | told


def _ballbar(path: Path) -> Document:
    found = read_ballbar(path)
    measured = {"angle_deg": ("deg", found.angle_deg), "radius_mm": ("mm", found.radius_mm)}
    columns = [column(name, unit, values) for name, (unit, values) in measured.items()]
    columns += [column(name, unit_of(name), values) for name, values in found.joints.items()]
    runs = analysed(found)
    notes = [*found.notes]
    for run in runs:
        x, y = run["centre_mm"]
        size = f"circularity {1000 * run['circularity_mm']:.1f} um about its centre ({x:+.4f}, {y:+.4f}) mm"
        notes.append(f"run {run['run']}, {run['direction']}: {size}, mean radius {run['mean_radius_mm']:.4f} mm")
    notes.append(
        "ready for kilter upload --device ballbar" if found.joints else "joins a joint log with kilter sheet-join"
    )
    told = {"notes": notes, "warnings": list(found.warnings)}
    return {"kind": "ballbar", "rows": len(found.radius_mm), "columns": columns, "runs": runs} | told


def _tdms(path: Path, hints: Hints) -> Document:
    from kilter_files.formats.tables.tdms import channels, read_channel

    out: list[Document] = []
    for channel in channels(path):
        about: Document = {
            "name": channel.name,
            "samples": channel.samples,
            "unit": channel.unit,
            "rate_hz": None if channel.step_s is None else 1 / channel.step_s,
            "scaled": channel.scaled,
        }
        if 0 < channel.samples <= 5_000_000 and len(out) < 64:
            values = read_channel(path, channel.name)[1]
            about |= {"low": float(values.min()), "high": float(values.max())}
        out.append(about)
    return {"kind": "tdms", "channels": out}


def _mat(path: Path, hints: Hints) -> Document:
    from kilter_files.formats.tables.mat import read_mat

    variables = read_mat(path).variables
    shapes = [{"name": name, "shape": list(np.shape(value))} for name, value in sorted(variables.items())]
    return {
        "kind": "mat",
        "variables": shapes,
        "notes": ["comes in with a column map (kilter upload --map); --draft writes a first one"],
    }


def _parquet(path: Path, hints: Hints) -> Document:
    from kilter_files.formats.tables.parquet import read_parquet

    source = read_parquet(path)
    columns = [{"name": name, "unit": unit_of(name)} for name in source.names]
    odd = [name for name in source.names if unit_of(name) is None]
    warnings = [f"no contract columns: {', '.join(odd[:SHOWN])} (--draft writes a column map)"] if odd else []
    return {"kind": "parquet", "rows": source.table.num_rows, "columns": columns, "warnings": warnings}


def _alike(columns: dict[str, list[float]]) -> list[str]:
    points = np.array([columns[f"{axis}_mm"] for axis in "xyz"]).T
    size = float(np.abs(points).max())
    same = len(points) - len(np.unique(points, axis=0))
    out = [f"{same} points are copies of others to the last digit"] if same else []
    if size < 20.0 and len(points) > 5:
        out.append(f"no coordinate is beyond {size:.3g} mm: are these metres declared as mm, 1000 times larger")
    return out
