"""The page on column maps names every key, format and unit of the code, and no other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kilter_files.formats.reader import MAP
from kilter_files.formats.registry import readers_for
from kilter_files.ground.units import SIZES, TIMESTAMP
from kilter_files.maps.column_map import read_map
from kilter_files.maps.columns import Section

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = (REPOSITORY / "docs/reference/column-maps.md").read_text(encoding="utf-8")
EVERYTHING = """
[file]
format = "csv"
[columns]
q1_deg = { from = "a", unit = "deg" }
"q*" = { from = "A*", unit = "deg" }
[orientation]
from = ["a", "b", "c"]
euler = "XYZ"
unit = "deg"
[pose_id]
same_joints_within_deg = 0.1
[rows]
keep = [{ column = "a", min = 0 }]
[join]
by = "row"
[join.file]
format = "csv"
[join.columns]
x_mm = { from = "x", unit = "mm" }
"""
# heading or sentence before a table of the page -> where the code reads those keys
TABLES = {
    "## `[file]`": "file",
    "## `[columns]`": "columns.q1_deg",
    "## `[orientation]`": "orientation",
    "## `[pose_id]`": "pose_id",
    "## `[rows]`": "rows",
    "A condition is": "rows.keep[0]",
    "## `[join]`": "join",
}


def asked(monkeypatch: pytest.MonkeyPatch, folder: Path) -> dict[str, set[str]]:
    """Every key the code asks a map for, by its place."""
    found: dict[str, set[str]] = {}
    real = Section.raw

    def raw(self: Section, key: str) -> object:
        found.setdefault(self.place, set()).add(key)
        return real(self, key)

    monkeypatch.setattr(Section, "raw", raw)
    (folder / "map.toml").write_text(EVERYTHING)
    read_map(folder / "map.toml", readers_for(MAP))
    return found


def documented(before: str) -> set[str]:
    """Keys in the first column of the first table behind a text."""
    behind = PAGE.partition(before)[2]
    table = re.search(r"\| key \| meaning \|\n\|---\|---\|\n((?:\|.*\n)+)", behind)
    assert table is not None
    return set(re.findall(r"^\| `(\w+)` \|", table[1], re.MULTILINE))


def test_every_key_is_documented_and_no_other(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    keys = asked(monkeypatch, tmp_path)
    for before, place in TABLES.items():
        assert documented(before) == keys[place], before
    assert keys["join.file"] == keys["file"]
    assert keys["join.columns.x_mm"] == keys["columns.q1_deg"]
    assert keys["columns.q*"] == keys["columns.q1_deg"] - {"value", "date_format"}
    last = PAGE.partition("## At the top\n")[2].split(" are all")[0]
    assert set(re.findall(r"`(\w+)`", last)) == keys[""]


def test_every_format_and_unit_is_documented() -> None:
    formats = re.findall(r"^\| `(\w+)` \| ((?:`\.\w+`(?:, )?)+) \|", PAGE, re.MULTILINE)
    assert {name: tuple(re.findall(r"\.\w+", ends)) for name, ends in formats} == {
        name: reader.endings for name, reader in readers_for(MAP).items()
    }
    assert PAGE.count("`csv`, `json`, `mat`, `parquet`, `tdms`, `xlsx`, `yaml` or `program`") == 1
    units = PAGE.partition("| of a | units |\n")[2].partition("\n\n")[0]
    stated = {
        name: tuple(re.findall(r"`([^`]+)`", line))
        for name, line in re.findall(r"^\| ([a-z ]+) \| (.*) \|$", units, re.M)
    }
    known = {name: tuple(sizes) for name, sizes in SIZES.items()} | {"temperature": ("C", "K")}
    assert stated == known | {"time": (*known["time"], TIMESTAMP)}


def test_the_example_with_everything_is_a_map() -> None:
    read_map(REPOSITORY / "clients/python/examples/columns.toml", readers_for(MAP))
