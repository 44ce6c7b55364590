"""The houses that the packages are: few rooms on few floors, every import downwards, and a page that shows them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tools.draw_rooms import CORE, FILES, House, direct, floors_of, imports_of_rooms, written

MOST_FILES = 20  # in a folder of the readers of files


@pytest.mark.parametrize(("house", "rooms", "most_floors"), [(CORE, 16, 8), (FILES, 8, 4)], ids=["core", "files"])
def test_a_house_has_few_rooms_on_few_floors(house: House, rooms: int, most_floors: int) -> None:
    floors = floors_of(imports_of_rooms(house))  # rooms that import each other in a circle are refused
    assert len(floors) <= rooms
    assert max(floors.values()) <= most_floors


def test_no_folder_of_the_readers_is_a_heap() -> None:
    folders = {path.parent for path in FILES.folder.rglob("*.py")}
    full = {str(folder.relative_to(FILES.folder)): len([*folder.glob("*.py")]) for folder in folders}
    assert {name: count for name, count in full.items() if count > MOST_FILES} == {}


def test_people_are_told_of_public_modules_only() -> None:
    docs = Path(__file__).resolve().parents[2] / "docs"
    pages = [page for folder in ("how-to", "reference", "tutorial") for page in (docs / folder).rglob("*.md")]
    named = {name for page in pages for name in re.findall(r"kilter_client\.(\w+)", page.read_text(encoding="utf-8"))}
    assert named == {"stream"}


def test_the_page_and_the_picture_show_the_imports_as_they_are() -> None:
    for path, words in written().items():
        assert path.read_text(encoding="utf-8") == words, f"{path.name} is stale: run `make rooms`"


def test_a_circle_of_rooms_is_named() -> None:
    circle = {"low": frozenset[str](), "one": frozenset({"low", "two"}), "two": frozenset({"one"})}
    with pytest.raises(ValueError, match="circle: one, two"):
        floors_of(circle)


def test_only_imports_that_no_other_implies_are_drawn() -> None:
    imports = {"ground": frozenset[str](), "middle": frozenset({"ground"}), "top": frozenset({"middle", "ground"})}
    assert direct(imports)["top"] == {"middle"}
    assert floors_of(imports) == {"ground": 1, "middle": 2, "top": 3}
