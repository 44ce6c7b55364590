"""How the points of a tracker are read."""

from __future__ import annotations

from kilter_files.formats.column import column
from kilter_files.formats.reader import Document, Head
from kilter_files.ground.later import np
from kilter_files.ground.units import column_unit
from kilter_files.tables.table import Table


def describe_points(head: Head, table: Table) -> Document:
    """Describe points that were read, and say which of them are suspicious."""
    assert head.layout is not None  # it was recognised
    columns = [column(name, column_unit(name), np.array(values)) for name, values in table.columns.items()]
    return {
        "layout": head.layout.to_document(),
        "rows": len(table),
        "columns": columns,
        "notes": table.notes,
        "warnings": table.warnings + _plausibility_warnings(table.columns),
    }


def _plausibility_warnings(columns: dict[str, list[float]]) -> list[str]:
    points = np.array([columns[f"{axis}_mm"] for axis in "xyz"]).T
    size = float(np.abs(points).max())
    same = len(points) - len(np.unique(points, axis=0))
    out = [f"{same} points are copies of others to the last digit"] if same else []
    if size < 20.0 and len(points) > 5:
        out.append(f"no coordinate is beyond {size:.3g} mm: are these metres declared as mm, 1000 times larger")
    return out
