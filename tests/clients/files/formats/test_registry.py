"""The list of readers: each file has one, whoever asks, and a new one is a module and a line."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from kilter_client import FileError, prepare
from kilter_files.formats import registry
from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.look.drafts import draft, inspect
from kilter_files.tables.source import Source, TextSource
from tests.clients.files.look.labs import LABS, write_lab

ROWS = [[10.0 * k, -5.0 * k, 3.0 * k - 40, 100.5 + k, 200.25 - k, 300.75] for k in range(1, 12)]
JOINTS = ["A1", "A2", "A3"]


class Toy(Reader[Source]):
    """Two columns with bars between."""

    name = "toy"
    title = "a toy"
    use = MAP
    endings = (".toy",)
    is_a = "a toy"
    instead = "Play."

    def recognises(self, head: Head) -> bool:
        """The first line."""
        return head.start.startswith(b"toy|")

    def describe(self, head: Head) -> Document:
        """How many rows."""
        return {"rows": len(self.read(head.path).lines)}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the rows."""
        cells = [line.split("|") for line in path.read_text().splitlines()[1:]]
        return TextSource(path, hints.layout, ["a", "b"], cells, list(range(2, len(cells) + 2)))


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A reader that was added: its module, and its line in the list."""
    module = ModuleType("kilter_files.formats.readers.toy")
    vars(module)["READER"] = Toy()
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(registry, "READERS", ("toy", *registry.READERS))
    registry.all_readers.cache_clear()
    yield
    registry.all_readers.cache_clear()


def test_a_new_reader_is_a_module_and_a_line(tmp_path: Path, toy: None) -> None:
    path = tmp_path / "log.toy"
    path.write_text("toy|1\n1|2\n3|4\n")
    columns = '[columns]\nq1_deg = { from = "a", unit = "deg" }\nx_mm = { from = "b", unit = "mm" }\n'
    (tmp_path / "m.toml").write_text(columns)
    assert prepare(path, column_map=tmp_path / "m.toml").content == b"q1_deg,x_mm\n1.0,2.0\n3.0,4.0\n"
    assert (inspect(path)["kind"], inspect(path)["rows"]) == ("toy", 2)
    assert ("upload --map", "toy", (".toy",), "a toy") in registry.list_formats()
    (tmp_path / "m.toml").write_text('[file]\nformat = "toys"\n' + columns)
    with pytest.raises(
        FileError, match="must be one of csv, json, mat, parquet, program, tdms, toy, xlsx, yaml, not 'toys'"
    ):
        prepare(path, column_map=tmp_path / "m.toml")


def test_every_reader_states_what_it_is() -> None:
    found = registry.all_readers()
    assert len(found) == len(registry.READERS)  # no name twice
    for reader in found.values():
        assert reader.title, reader.name
        assert bool(reader.is_a) or not reader.instead, reader.name
        assert list(reader.names_and_titles()), reader.name


def test_a_reader_is_stated_without_the_packages_that_it_needs() -> None:
    """`kilter measure formats` and `kilter upload` list and use them where numpy is not installed."""
    import subprocess

    code = (
        "import sys; from kilter_files.formats.registry import list_formats; rows = list(list_formats()); "
        "print(len(rows), *sorted({'numpy', 'scipy', 'pyarrow', 'openpyxl', 'nptdms', 'rosbags'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(len(list(registry.list_formats())))]


def table(path: Path, head: str, delimiter: str = ",") -> Path:
    rows = [delimiter.join(f"{value:.4f}" for value in row) for row in ROWS]
    path.write_text("\n".join([*([head] if head else []), *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("head", "delimiter"),
    [
        ("# A1;A2;A3;X;Y;Z", ";"),  # a header in a comment: A1 was called x
        ("A1|A2|A3|X|Y|Z", "|"),  # was no table at all
        ("A1 A2 A3 X Y Z", " "),
        ("A1,A2,A3,px,py,pz", ","),
        ("", ","),  # no names: nobody knows which column is x
    ],
)
def test_inspection_and_draft_see_the_same_table(tmp_path: Path, head: str, delimiter: str) -> None:
    path = table(tmp_path / "lab.txt", head, delimiter)
    found, drafted = inspect(path), draft(path)
    assert (found["kind"], found["rows"]) == ("table", len(ROWS))
    assert [note.removeprefix("not told: ") for note in found["notes"] if note.startswith("not told")] == drafted.open
    assert [note.removeprefix("check ") for note in found["notes"] if note.startswith("check")] == drafted.guessed
    lows = [column["low"] for column in found["columns"]]
    assert lows == [min(column) for column in zip(*ROWS, strict=True)]
    if head:
        assert not [place for place in drafted.open if not place.startswith("columns.q")]
        assert 'x_mm = { from = "' in drafted.text


@pytest.mark.parametrize("name", LABS)
def test_no_file_of_a_lab_is_taken_for_points_alone(tmp_path: Path, name: str) -> None:
    path, _ = write_lab(tmp_path, name)
    found = inspect(path)
    assert found["kind"] in ("table", "mat", "parquet")
    assert not found["ready"]


def test_points_alone_are_points_and_a_contract_is_ready(tmp_path: Path) -> None:
    points = tmp_path / "points.txt"
    points.write_text("\n".join(["P1 1.5 2.5 300.25", "P2 10.5 20.5 301.5", "P3 5.5 8.5 302.75"]) + "\n")
    assert inspect(points)["kind"] == "tracker-text"
    rows = table(tmp_path / "rows.csv", "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm")
    assert (inspect(rows)["kind"], inspect(rows)["ready"]) == ("contract-columns", True)
    columns = tmp_path / "rows.json"
    columns.write_text('{"q1_deg": [1.0, 2.0], "x_mm": [3.0, 4.0]}')
    assert (inspect(columns)["kind"], inspect(columns)["rows"], inspect(columns)["ready"]) == ("json-columns", 2, True)


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "is empty"), (b"\x1f\x8b\x08", "is compressed with gzip"), (b"PK\x03\x04abc", "is a ZIP archive")],
)
def test_what_nobody_reads_is_named(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(FileError, match=words):
        inspect(tmp_path / "a.csv")
