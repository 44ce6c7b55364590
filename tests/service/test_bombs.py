"""Small uploads that would cost much: what they cost is counted in bytes and calls, not in seconds."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from kilter_core.errors import ObservationError
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.tables import reading

pytestmark = pytest.mark.timeout(60)  # only a backstop: what it replaces took minutes
REPOSITORY = Path(__file__).resolve().parents[2]


def read(path: Path, media: str) -> None:
    reading.column_names(path, media)
    for _ in reading.tables(path, media):
        pass


def refused(tmp_path: Path, content: bytes, media: str = reading.CSV) -> str:
    path = tmp_path / "body"
    path.write_bytes(content)
    with pytest.raises((ObservationError, ServiceError)) as caught:
        read(path, media)
    assert len(caught.value.message) < 1000, "the refusal repeats what was sent"
    return caught.value.message


class Name(str):
    """A column name that counts how often it is compared."""

    compared = 0

    def __eq__(self, other: object) -> bool:
        Name.compared += 1
        return str.__eq__(self, other)

    __hash__ = str.__hash__


def test_names_are_compared_about_once_each() -> None:
    """A header of 60 000 names cost 197 s, each name compared with all."""
    Name.compared = 0
    reading.check_names([Name(f"c{k}") for k in range(1000)])
    assert Name.compared < 2000


def test_a_header_of_many_names_is_refused_before_it_is_taken_apart(tmp_path: Path) -> None:
    assert "longer than 65536 bytes" in refused(tmp_path, b",".join(b"c%d" % k for k in range(30_000)) + b"\n1\n")
    assert "at most 1000 are allowed" in refused(tmp_path, b",".join(b"c%d" % k for k in range(1001)) + b"\n1\n")
    columns = {f"c{k}": [1.0] for k in range(1001)}
    assert "at most 1000 are allowed" in refused(tmp_path, json.dumps(columns).encode(), reading.JSON)
    buffer = io.BytesIO()
    parquet.write_table(pa.table(columns), buffer)
    assert "1001 columns" in refused(tmp_path, buffer.getvalue(), reading.PARQUET)


@pytest.mark.parametrize("media", [reading.CSV, reading.JSON, reading.PARQUET])
def test_a_long_name_is_refused_and_not_repeated(tmp_path: Path, media: str) -> None:
    name = "q" * 5000
    buffer = io.BytesIO()
    parquet.write_table(pa.table({name: [1.0]}), buffer)
    bodies = {
        reading.CSV: f"{name}\n1\n".encode(),
        reading.JSON: json.dumps({name: [1]}).encode(),
        reading.PARQUET: buffer.getvalue(),
    }
    assert "more than 64 characters" in refused(tmp_path, bodies[media], media)


def test_a_cell_of_many_digits_is_looked_at_once() -> None:
    """As `\\d+\\.?\\d*` it was tried in all ways to split it, 10^12 steps for this cell: the backstop would end it."""
    assert reading._NUMBER.fullmatch("1" * 1_000_000 + "x") is None
    for good in ("1", "-1.5", ".5", "5.", "1e5", "+1.5E-3"):
        assert reading._NUMBER.fullmatch(good)
    for bad in ("", ".", "1e", "e5", "1.2.3", "--1", "٣"):
        assert not reading._NUMBER.fullmatch(bad)


def test_csv_lines_and_cells_without_an_end_are_refused(tmp_path: Path) -> None:
    assert "longer than 1048576 bytes" in refused(tmp_path, b"q1_deg,x_mm\n" + b"," * (2 << 20))
    assert "Row 1" in refused(tmp_path, b'q1_deg,x_mm\n"' + b"1,\n" * 200_000)
    assert "'1111" in refused(tmp_path, b"q1_deg,x_mm\n1," + b"1" * 5000 + b"x\n")


@pytest.mark.parametrize(
    "body",
    [
        b"[" * 100_000,
        b'{"q1_deg":' * 50_000,
        b'{"q1_deg": [' + b"[]," * 100_000 + b"[]]}",
        b'{"q1_deg": [' + b"{}," * 100_000 + b"{}]}",
        b'{"q1_deg": [' + b'"ab",' * 100_000 + b"1]}",
    ],
)
def test_deep_and_scattered_json_is_refused_before_it_is_parsed(
    tmp_path: Path, body: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(json, "loads", lambda *_, **__: pytest.fail("it was parsed"))
    assert "must be columns of numbers" in refused(tmp_path, body, reading.JSON)


def test_json_numbers_beyond_the_doubles_are_refused(tmp_path: Path) -> None:
    assert "Row 2, column 'q1_deg' is too large" in refused(
        tmp_path, b'{"q1_deg": [1, 1' + b"0" * 400 + b"]}", reading.JSON
    )
    assert "not JSON" in refused(tmp_path, b'{"q1_deg": [1' + b"0" * 100_000 + b"]}", reading.JSON)
    assert "q1_deg" in refused(tmp_path, b'{"q1_deg": [1e999]}', reading.JSON)
    path = tmp_path / "whole"
    path.write_bytes(b'{"q1_deg": [9007199254740993]}')
    assert next(reading.tables(path, reading.JSON)).column("q1_deg").to_pylist() == [9007199254740992.0]


def test_json_is_taken_up_to_a_size(tmp_path: Path) -> None:
    assert "32 MB" in refused(tmp_path, b'{"q1_deg": [' + b"0," * (17 << 20) + b"0]}", reading.JSON)


def bomb(path: Path, rows: int, columns: int, **options: Any) -> None:
    table = pa.table({f"c{k}": pa.array(np.zeros(rows)) for k in range(columns)})
    parquet.write_table(table, path, **options)


PEAK = """
import resource, sys
from pathlib import Path
from kilter_service.ground.tables import reading
def peak():
    return int(next(l for l in open("/proc/self/status") if l.startswith("VmHWM")).split()[1]) / 1024
import pyarrow, pyarrow.compute, pyarrow.parquet
before = peak()
try:
    names = reading.column_names(Path(sys.argv[1]), reading.PARQUET)
    rows = sum(table.num_rows for table in reading.tables(Path(sys.argv[1]), reading.PARQUET))
    print("rows", rows)
except reading.ObservationError as error:
    print("refused", error.message)
print(peak() - before)
"""


def memory(path: Path) -> tuple[str, float]:
    """Read a file in a process of its own; returns what came of it and the MB it took at its peak."""
    command = [sys.executable, "-c", PEAK, str(path)]
    out = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.splitlines()
    return out[0], float(out[-1])


def test_a_parquet_file_is_decoded_in_pieces(tmp_path: Path) -> None:
    """Zeros of 500 columns: 450 kB that took 780 MB."""
    path = tmp_path / "wide.parquet"
    bomb(path, 60_000, 500)
    assert path.stat().st_size < 1_000_000
    what, peak = memory(path)
    assert what == "rows 60000"
    assert peak < 250


def test_a_parquet_file_of_too_many_cells_is_refused_by_what_it_states(tmp_path: Path) -> None:
    path = tmp_path / "long.parquet"
    bomb(path, 1_100_000, 50)
    what, peak = memory(path)
    assert "more than 50000000 cells" in what
    assert peak < 30


def test_a_page_that_unpacks_to_hundreds_of_megabytes_is_refused_unopened(tmp_path: Path) -> None:
    path = tmp_path / "page.parquet"
    bomb(path, 40_000_000, 1, data_page_size=1 << 30, use_dictionary=False, compression="zstd", row_group_size=1 << 30,
         write_batch_size=1 << 30, max_rows_per_page=1 << 30)  # fmt: skip
    assert path.stat().st_size < 1_000_000
    what, peak = memory(path)
    assert "unpack to more than 256 MB" in what
    assert peak < 60


def test_pages_are_what_they_say_and_not_what_the_footer_says(tmp_path: Path) -> None:
    """A page header changed in place, where the footer still tells of one small page."""
    path = tmp_path / "lie.parquet"
    values = np.random.default_rng(0).normal(size=1000)
    parquet.write_table(pa.table({"q1_deg": values}), path, use_dictionary=False, compression="none")
    chunk = parquet.read_metadata(path).row_group(0).column(0)
    start, data = chunk.data_page_offset, bytearray(path.read_bytes())
    # Fields 1 (type), 2 (bytes unpacked), 3 (bytes packed), each a zigzag varint after its head.
    assert data[start : start + 3] == b"\x15\x00\x15"
    end = start + 3
    while data[end] >= 128:
        end += 1
    width = end + 1 - start - 3
    data[start + 3 : end + 1] = b"\xfe\xff\xff\xff\x0f"[:width] if width == 5 else b"\xff" * (width - 1) + b"\x7f"
    path.write_bytes(bytes(data))
    what, peak = memory(path)
    assert what.startswith("refused")
    assert peak < 60


def test_a_huge_footer_and_many_pages_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "footer.parquet"
    path.write_bytes(b"PAR1" + bytes(3 << 20) + (3 << 20).to_bytes(4, "little") + b"PAR1")
    assert "describes itself" in memory(path)[0]
    bomb(path, 120_000, 1, data_page_size=1, use_dictionary=False, write_batch_size=1)
    assert "more than 100000 pages" in memory(path)[0]


def test_nested_columns_and_text_are_refused(tmp_path: Path) -> None:
    for column in ([[1.0, 2.0]], [{"a": 1.0}], ["1"], [b"1"], [True]):
        buffer = io.BytesIO()
        parquet.write_table(pa.table({"q1_deg": column}), buffer)
        assert "not numbers. Send a column for each number" in refused(tmp_path, buffer.getvalue(), reading.PARQUET)


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("compression", ["none", "snappy", "gzip", "zstd", "brotli"])
def test_pages_of_every_kind_are_understood(tmp_path: Path, version: str, compression: str) -> None:
    random = np.random.default_rng(1)
    table = pa.table(
        {
            "q1_deg": random.normal(size=5000),
            "q2_deg": pa.array(np.repeat(1.5, 5000)),
            "m1x_mm": pa.array([None if k % 3 else k / 7 for k in range(5000)]),
            "pose_id": pa.array(np.arange(5000), pa.int32()),
            "x_mm": pa.array(random.normal(size=5000).astype(np.float32)),
        }
    )
    path = tmp_path / "file"
    options = {"data_page_version": version, "compression": compression, "row_group_size": 1700, "data_page_size": 3000}
    parquet.write_table(table, path, **options, write_page_checksum=True, column_encoding="PLAIN", use_dictionary=False)
    for extra in ({}, {"use_dictionary": ["q2_deg", "m1x_mm"]}):
        parquet.write_table(table, path, **options, **extra)
        pieces = list(reading.tables(path, reading.PARQUET))
        whole = pa.concat_tables(pieces)
        assert whole.equals(table.cast(whole.schema))


def test_a_trajectory_is_not_read_further_than_it_may_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "body"
    path.write_bytes(b"q1_deg\n" + b"1\n" * 6_000_000)
    read = []
    pieces = reading.tables
    monkeypatch.setattr(reading, "tables", lambda *given: (read.append(piece) or piece for piece in pieces(*given)))
    with pytest.raises(ObservationError, match="more than 1000 rows"):
        reading.whole_table(path, reading.CSV, 1000)
    assert len(read) == 1


FUZZ = """
import random, sys
from pathlib import Path
from kilter_service.ground.tables import reading
from kilter_core.errors import CoreError
path, draw = Path(sys.argv[1]), random.Random(int(sys.argv[2]))
kinds = {".parquet": reading.PARQUET, ".csv": reading.CSV, ".json": reading.JSON}
whole = [(kinds[p.suffix], p.read_bytes()) for p in sorted(path.glob("whole*"))]
for number in range(int(sys.argv[3])):
    media, content = draw.choice(whole)
    content = bytearray(content)
    for _ in range(draw.choice((1, 1, 2, 5, 20))):
        at = draw.randrange(len(content) + 1)
        size, added = draw.choice(((1, 1), (1, 1), (0, 1), (0, 1000), (4, 0), (50, 0)))
        content[at : at + size] = bytes([draw.randrange(256)]) * added
    (path / "damaged").write_bytes(content)
    try:
        reading.column_names(path / "damaged", media)
        for _ in reading.tables(path / "damaged", media):
            pass
    except CoreError as error:
        assert len(error.message) < 1000
print("done")
"""


def test_damaged_files_are_refused_and_end_nothing(tmp_path: Path) -> None:
    """One changed byte of a footer ended the process: pyarrow's view of a column chunk throws where nobody catches it."""
    random = np.random.default_rng(0)
    table = pa.table(
        {
            "q1_deg": random.normal(size=300),
            "m1x_mm": pa.array([None if k % 3 else 1.5 for k in range(300)]),
            "pose_id": np.arange(300),
        }
    )
    for k, (compression, dictionary) in enumerate((c, d) for c in ("none", "snappy", "zstd") for d in (True, False)):
        parquet.write_table(table, tmp_path / f"whole{k}.parquet", compression=compression, use_dictionary=dictionary)
    (tmp_path / "whole7.csv").write_bytes(b"q1_deg,x_mm\n1,2\n3,4\n")
    (tmp_path / "whole8.json").write_bytes(b'{"q1_deg": [1, 2.5], "x_mm": [null, 3]}')
    command = [sys.executable, "-c", FUZZ, str(tmp_path), "3", "3000"]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.stdout == "done\n", done.stderr[-3000:]


def test_lines_that_end_with_a_carriage_return_alone_are_told(tmp_path: Path) -> None:
    assert "carriage return alone" in refused(tmp_path, b"q1_deg,x_mm\r1,2\r3,4\r")
