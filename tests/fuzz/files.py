"""Bodies that are files: CSV, Parquet, JSON columns and URDF, whole, damaged and hostile. Shares no code with Kilter."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable
from typing import Any

import pyarrow as pa
from hypothesis import strategies as st
from pyarrow import parquet

from tests.fuzz.values import RAW, anything, numbers, texts

CSV, PARQUET, JSON = "text/csv", "application/vnd.apache.parquet", "application/json"
JOINTS = 5
NAMES = [f"q{j}_deg" for j in range(1, JOINTS + 1)] + ["x_mm", "y_mm", "z_mm"]
OTHERS = ["q1_rad", "qd1_deg_s", "tau1_nm", "dir1", "payload_kg", "m1x_mm", "m1y_mm", "m1z_mm", "session", "t_s", "qw",
          "pose_id", "temperature_c", "tilt1x_deg", "link1_deg", "socket", "plane", "q6_deg", "q99_deg", "q1_deg"]  # fmt: skip
CELLS = ["", "1", "-12.5", "1e5", "1e999", "-1e-999", "nan", "inf", "0x10", "1_0", "1,5", '"', '"1"', "=1+1", "\x00",
         "١", "9" * 401, "true", " 1", "1 ", "+3", ".", "-", "2e", "\ud83e", "a"]  # fmt: skip
ENDS = ["\n", "\r\n", "\r", "\n\n", "\x0b", "\u2028", ""]
KINDS: list[Any] = [pa.float64(), pa.float32(), pa.int64(), pa.string(), pa.bool_(), pa.decimal128(38, 3), pa.timestamp("us"),
                     pa.list_(pa.float64()), pa.dictionary(pa.int32(), pa.string()), pa.binary(), pa.uint64()]  # fmt: skip


@st.composite
def columns(draw: st.DrawFn) -> list[str]:
    """Names of columns, mostly those of a campaign of the arm."""
    names = list(NAMES)
    names += draw(st.lists(st.one_of(st.sampled_from(OTHERS), texts), max_size=2))
    if draw(st.integers(0, 3)) == 0:
        names.remove(draw(st.sampled_from(NAMES)))
    return names


@st.composite
def csv_file(draw: st.DrawFn) -> bytes:
    """A table as text."""
    names, end = draw(columns()), draw(st.sampled_from(ENDS))
    separator = draw(st.sampled_from([",", ",", ",", ",", ";", "\t"]))
    plain = st.floats(-90, 90).map(repr)
    odd = draw(st.integers(0, 2)) == 0
    lines = [separator.join(names)]
    for _ in range(draw(st.integers(0, 5))):
        cells = [draw(st.one_of(plain, plain, plain, st.sampled_from(CELLS))) if odd else draw(plain) for _ in names]
        lines.append(
            separator.join(cells[: draw(st.integers(0, len(cells)))] if draw(st.integers(0, 20)) == 0 else cells)
        )
    data = end.join([*lines, ""]).encode(draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16"])), "surrogatepass")
    return _damaged(draw, data)


@st.composite
def parquet_file(draw: st.DrawFn) -> bytes:
    """A table as Parquet."""
    names, rows, buffer = draw(columns()), draw(st.integers(0, 5)), io.BytesIO()
    names = [name.encode("utf-8", "replace").decode() for name in names]
    kinds = [draw(st.sampled_from(KINDS)) if draw(st.integers(0, 9)) == 0 else pa.float64() for _ in names]
    value = draw(st.sampled_from([1.5, 0.0, 1e300, float("nan"), float("inf"), None]))
    arrays = [_array(kind, value, rows) for kind in kinds]
    codec = draw(st.sampled_from(["snappy", "zstd", "gzip", "none", "brotli"]))
    table = pa.Table.from_arrays(arrays, names=names)
    parquet.write_table(table, buffer, compression=codec, version=draw(st.sampled_from(["1.0", "2.6"])))
    return _damaged(draw, buffer.getvalue())


def _array(kind: Any, value: float | None, rows: int) -> Any:
    try:
        return pa.array([value] * rows, kind)
    except (pa.ArrowException, TypeError, ValueError, ArithmeticError):
        return pa.nulls(rows, kind)


@st.composite
def json_columns(draw: st.DrawFn) -> bytes:
    """A table as JSON columns."""
    rows = draw(st.integers(0, 4))
    cell: Any = st.floats(-90, 90)
    if draw(st.integers(0, 2)) == 0:
        cell = st.one_of(cell, cell, numbers, anything)
    table: Any = {name: draw(st.lists(cell, min_size=rows, max_size=rows)) for name in draw(columns())}
    if draw(st.integers(0, 9)) == 0:
        table = draw(anything)
    return _damaged(draw, json.dumps(table).encode())


JOINT = (
    '<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
    '<origin xyz="{xyz}" rpy="0 0 0"/><axis xyz="{axis}"/><limit lower="{low}" upper="2" effort="1" velocity="1"/></joint>'
)
NUMBER = ["0", "1", "0.1", "1e308", "1e999", "nan", "-inf", "", "a", "1 2", "9" * 400]


@st.composite
def urdf(draw: st.DrawFn) -> str:
    """An arm as URDF, or what looks like one."""
    if draw(st.integers(0, 9)) == 0:
        return draw(texts)
    count, odd = draw(st.integers(0, 7)), draw(st.integers(0, 1)) == 0
    number = st.sampled_from(NUMBER) if odd else st.sampled_from(["0", "0.1", "1"])
    link = st.sampled_from([f"l{k}" for k in range(count + 2)])
    parts = [f'<link name="l{k}"/>' for k in range(count + 1)]
    for k in range(count):
        at = " ".join(draw(number) for _ in range(3))
        odd_link = odd and draw(st.integers(0, 5)) == 0
        parts.append(
            JOINT.format(
                name=draw(texts).replace("<", "").replace('"', "") if odd else f"j{k}",
                low=draw(number),
                xyz=at,
                kind=draw(st.sampled_from(["revolute", "prismatic", "fixed", "continuous", "floating"])),
                parent=draw(link) if odd_link else f"l{k}",
                child=draw(link) if odd_link else f"l{k + 1}",
                axis=draw(st.sampled_from(["0 0 1", "0 1 0", "0 0 0", "1 1", "nan 0 0", "1e200 0 0", "1e-200 0 0"])),
            )
        )
    head = draw(
        st.sampled_from(["", "", "", '<?xml version="1.0" encoding="utf-16"?>', '<!DOCTYPE a [<!ENTITY b "c">]>'])
    )
    return f'{head}<robot name="r">{"".join(parts)}</robot>'


def _damaged(draw: st.DrawFn, data: bytes) -> bytes:
    """The bytes, one time in six cut off, with a byte changed, or other bytes altogether."""
    how = draw(st.integers(0, 17))
    if how == 0:
        return data[: draw(st.integers(0, len(data)))]
    if how == 1 and data:
        at = draw(st.integers(0, len(data) - 1))
        return data[:at] + bytes([draw(st.integers(0, 255))]) + data[at + 1 :]
    return draw(st.sampled_from(RAW)) if how == 2 else data


@st.composite
def obj(draw: st.DrawFn) -> bytes:
    """Triangles as OBJ, or what looks like them."""
    odd = draw(st.integers(0, 2)) == 0
    number = st.sampled_from(NUMBER) if odd else st.sampled_from(["0", "0.1", "1", "-2.5"])
    corners = draw(st.integers(0, 6))
    lines = [f"v {draw(number)} {draw(number)} {draw(number)}" for _ in range(corners)]
    index = st.integers(-9, 9) if odd else st.integers(1, max(corners, 1))
    lines += [f"f {draw(index)} {draw(index)} {draw(index)}" for _ in range(draw(st.integers(0, 4)))]
    return _damaged(draw, "\n".join(lines).encode())


@st.composite
def stl(draw: st.DrawFn) -> bytes:
    """Triangles as binary STL; the count beside them is not always right."""
    stated = draw(st.sampled_from([0, 1, 2, 3, 2**31, 2**32 - 1]))
    values = st.sampled_from([0.0, 1.0, -2.5, 1e38, float("nan"), float("inf")])
    parts = [struct.pack("<12fH", *(draw(values) for _ in range(12)), 0) for _ in range(draw(st.integers(0, 3)))]
    return _damaged(draw, bytes(80) + struct.pack("<I", stated) + b"".join(parts))


FILES: dict[str, Callable[[], st.SearchStrategy[bytes]]] = {
    CSV: csv_file, PARQUET: parquet_file, JSON: json_columns, "model/obj": obj, "model/stl": stl,
}  # fmt: skip
