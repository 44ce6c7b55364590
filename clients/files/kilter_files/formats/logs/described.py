"""How the log of an instrument is read."""

from __future__ import annotations

from kilter_files.formats.logs.ballbar import circle_fit_by_run, read_ballbar
from kilter_files.formats.logs.inclinometer import read_inclinometer
from kilter_files.formats.reader import Document, Head, column
from kilter_files.ground.units import column_unit


def describe_inclinometer(head: Head) -> Document:
    """Describe the log of an inclinometer."""
    assert head.layout is not None  # it was recognised
    found = read_inclinometer(head.path, head.hints.unit)
    columns = [column(name, column_unit(name), values) for name, values in found.columns.items()]
    rows = len(found.columns["t_s"])
    told = {"notes": list(found.notes), "warnings": list(found.warnings)}
    shape = {"layout": head.layout.to_document()}
    return {"rows": rows, "columns": columns} | told | shape


def describe_ballbar(head: Head) -> Document:
    """Describe the log of a ball bar; with joints it is ready to be sent."""
    assert head.layout is not None  # it was recognised
    found = read_ballbar(head.path)
    measured = {"angle_deg": ("deg", found.angle_deg), "radius_mm": ("mm", found.radius_mm)}
    columns = [column(name, unit, values) for name, (unit, values) in measured.items()]
    columns += [column(name, column_unit(name), values) for name, values in found.joints.items()]
    runs = circle_fit_by_run(found)
    notes = [*found.notes]
    for run in runs:
        x, y = run["centre_mm"]
        size = f"circularity {1000 * run['circularity_mm']:.1f} um about its centre ({x:+.4f}, {y:+.4f}) mm"
        notes.append(f"run {run['run']}, {run['direction']}: {size}, mean radius {run['mean_radius_mm']:.4f} mm")
    notes.append(
        "ready for kilter upload --device ballbar"
        if found.joints
        else "joins a joint log with kilter measure sheet-join"
    )
    told = {"notes": notes, "warnings": list(found.warnings), "ready": bool(found.joints), "device": "ballbar"}
    shape = {"layout": head.layout.to_document()}
    return {"rows": len(found.radius_mm), "columns": columns, "runs": runs} | told | shape
