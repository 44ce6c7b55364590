"""Markers in contract columns, checked before they are sent: whether one was knocked between the rows."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import MissingPackageError, fault
from kilter_files.ground.later import later, need, np, pa, parquet
from kilter_files.ground.units import MARKER
from kilter_files.tables.table import CSV_TYPE, JSON_TYPE, Prepared

with later(__name__):  # they need numpy, which rows without markers do not
    from kilter_files.match import knocks

A_MARKER = re.compile(rb"m[1-9]\d?[xyz]_")
SHOWN = 4


def checked_markers(path: Path, prepared: Prepared, unchecked: bool) -> Prepared:
    """Refuse rows in which a marker was knocked, or where the person allows them add the warning.

    Rows without markers come back as they are; so do all where numpy is missing, and the server looks by itself.

    Raises:
        FileError: marker, rows and size.

    """
    if prepared.content_type == CSV_TYPE and not A_MARKER.search(prepared.content.split(b"\n", 1)[0]):
        return prepared
    try:
        found = _check_knocks(path, prepared, unchecked)
    except ImportError:
        return prepared
    return replace(prepared, warnings=(*prepared.warnings, *found)) if found else prepared


def _check_knocks(path: Path, prepared: Prepared, unchecked: bool) -> list[str]:
    numbers = sorted({int(m[1]) for name in _names(prepared) if (m := MARKER.fullmatch(name))})
    if len(numbers) < 2:
        return []
    points = _points(prepared, numbers)
    found = [] if points is None else knocks.knocks_of_rows(points)
    if points is None or not found:
        return []
    names = tuple(f"m{k}" for k in numbers)
    exchanged = knocks.changed_places(points, round(found[0].from_s))
    if exchanged:
        who = " and ".join(repr(names[k]) for k in exchanged)
        what = f"markers {who} change places between rows {found[0].from_s:.0f} and {found[0].to_s:.0f}"
    else:
        what = "; ".join(knock.describe_knock(names, "rows") for knock in found[:SHOWN])
    if unchecked:
        return [what]
    if exchanged:
        raise fault(path, what, "Exchange their columns from there on. --unchecked sends the file anyway.")
    columns = f"the columns of {names[found[0].markers[0]]}" if len(found[0].markers) == 1 else "its columns"
    remedy = (
        f"Send the rows before and after as campaigns of their own, or leave {columns} out and renumber the others."
    )
    raise fault(path, what, f"{remedy} --unchecked sends it anyway.")


def _names(prepared: Prepared) -> list[str]:
    if prepared.content_type == CSV_TYPE:
        head = prepared.content.split(b"\n", 1)[0].decode("utf-8-sig", "replace")
        return [name.strip() for name in next(csv.reader([head]), [])]
    if prepared.content_type == JSON_TYPE:
        return list(_json(prepared))
    return list(_parquet(prepared, None))


def _points(prepared: Prepared, numbers: Sequence[int]) -> Floats | None:
    """The markers (n, m, 3) mm; None where the cells are not numbers, which the server says better."""
    names = {(m[1], m[2]): name for name in _names(prepared) if (m := MARKER.fullmatch(name))}
    wanted = [names.get((str(k), axis)) for k in numbers for axis in "xyz"]
    if None in wanted:
        return None
    try:
        columns = _columns(prepared, [str(name) for name in wanted])
        table = np.stack([np.asarray(columns[str(n)], dtype=np.float64) for n in wanted], axis=1)
    except (ValueError, TypeError, KeyError, IndexError):
        return None
    scale = np.array([1000.0 if str(name).endswith("_m") else 1.0 for name in wanted])
    points = (table * scale).reshape(len(table), len(numbers), 3)
    points[np.isnan(points).any(axis=2)] = np.nan
    return np.asarray(points)


def _columns(prepared: Prepared, wanted: list[str]) -> Mapping[str, Any]:
    if prepared.content_type == JSON_TYPE:
        return _json(prepared)
    if prepared.content_type != CSV_TYPE:
        return _parquet(prepared, wanted)
    at = [_names(prepared).index(name) for name in wanted]
    rows = csv.reader(io.StringIO(prepared.content.decode("utf-8-sig")))
    next(rows)
    table = [[float(row[k]) if row[k].strip() else np.nan for k in at] for row in rows if row]
    return dict(zip(wanted, np.array(table, dtype=np.float64).reshape(-1, len(at)).T, strict=True))


def _json(prepared: Prepared) -> dict[str, Any]:
    try:
        found = json.loads(prepared.content)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _parquet(prepared: Prepared, wanted: list[str] | None) -> Mapping[str, Any]:
    try:
        need("Parquet files need", "pyarrow")
    except MissingPackageError:
        return {}
    try:
        file = parquet.ParquetFile(io.BytesIO(prepared.content))
        if wanted is None:
            return dict.fromkeys(file.schema_arrow.names)
        table = file.read(columns=wanted)
    except (pa.ArrowException, OSError):
        return {}
    return {name: table.column(name).to_numpy() for name in table.column_names}
