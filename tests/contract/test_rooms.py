"""The houses that the packages are: few rooms on few floors, every import downwards, and a page that shows them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.contract.sources import REPOSITORY, source
from tools.draw_rooms import (
    CLIENT,
    CORE,
    FILES,
    HOUSES,
    SERVICE,
    House,
    Room,
    between,
    direct,
    floors_of,
    graph_of,
    imports_in,
    imports_of_rooms,
    imports_of_units,
    path,
    rooms_of,
    written,
)

MOST_FILES = 20  # in a folder
MOST_IMPORTS = {"core/kilter_core/gap/find.py": 20}  # of modules that read like the method: a step from each
LISTS = ("effects", "contract", "typed")  # of what stands side by side: an effect, a document in a file


@pytest.mark.parametrize(
    ("house", "most_rooms", "most_floors"),
    [(CORE, 18, 8), (SERVICE, 13, 9), (FILES, 8, 4), (CLIENT, 7, 5)],
    ids=["core", "service", "files", "client"],
)
def test_a_house_has_few_rooms_on_few_floors(house: House, most_rooms: int, most_floors: int) -> None:
    floors = floors_of(imports_of_rooms(house))
    assert len(floors) <= most_rooms
    assert max(floors.values()) <= most_floors


@pytest.mark.parametrize("house", HOUSES, ids=lambda house: house.name)
def test_no_folder_is_a_heap(house: House) -> None:
    folders = {path.parent for path in house.folder.rglob("*.py") if path.parent.name not in LISTS}
    full = {str(folder.relative_to(house.folder)): len([*folder.glob("*.py")]) for folder in folders}
    assert {name: count for name, count in full.items() if count > MOST_FILES} == {}


@pytest.mark.parametrize("module", MOST_IMPORTS)
def test_a_module_that_reads_like_the_method_imports_little_beside_its_steps(module: str) -> None:
    assert len(source(REPOSITORY / module).imported) <= MOST_IMPORTS[module]


@pytest.mark.parametrize("house", HOUSES, ids=lambda house: house.name)
def test_each_folder_and_module_stands_in_one_room(house: House) -> None:
    held = [unit for room in rooms_of(house).values() for unit in room.holds]
    assert sorted(held) == sorted(imports_of_units(house))


@pytest.mark.parametrize("house", HOUSES, ids=lambda house: house.name)
def test_no_folders_and_modules_of_a_folder_import_each_other_in_a_circle(house: House) -> None:
    graph = graph_of(house)
    folders = [
        house.package,
        *(module for module in graph.find_descendants(house.package) if graph.find_children(module)),
    ]
    assert len(folders) > 5
    for folder in folders:
        floors_of(imports_in(graph, folder))  # raises where they do


def test_a_room_imports_none_that_stands_before_it() -> None:
    names = list(rooms_of(CLIENT))
    assert not [
        (room, other)
        for room, others in imports_of_rooms(CLIENT).items()
        for other in others
        if names.index(other) < names.index(room)
    ]


def test_rooms_begin_with_floors_of_their_contract() -> None:
    with pytest.raises(ValueError, match="rooms of kilter_client do not begin with floors"):
        rooms_of(replace(CLIENT, contract="core-rooms"))


def test_imports_of_folders_become_imports_of_rooms_and_one_without_a_floor_is_named() -> None:
    imports = {"c": frozenset({"a", "b"}), "b": frozenset({"a"}), "a": frozenset[str]()}
    assert between(imports, {"up": Room("", ("c", "b")), "down": Room("", ("a",))}) == {
        "down": frozenset(),
        "up": frozenset({"down"}),
    }
    with pytest.raises(ValueError, match="no floor for a, b: give each one"):
        between(imports, {"up": Room("", ("c",))})


def test_the_page_and_the_pictures_show_the_imports_as_they_are() -> None:
    for file, words in written().items():
        assert file.read_text(encoding="utf-8") == words, f"{file.name} is stale: run `python -m tools.draw_rooms`"


def test_people_are_told_of_public_modules_only() -> None:
    docs = Path(__file__).resolve().parents[2] / "docs"
    pages = [page for folder in ("how-to", "reference", "tutorial") for page in (docs / folder).rglob("*.md")]
    named = {name for page in pages for name in re.findall(r"kilter_client\.(\w+)", page.read_text(encoding="utf-8"))}
    assert named == {"stream"}


def test_a_circle_of_rooms_is_named() -> None:
    circle = {"low": frozenset[str](), "one": frozenset({"low", "two"}), "two": frozenset({"one"})}
    with pytest.raises(ValueError, match="circle: one, two"):
        floors_of(circle)


def test_only_imports_that_no_other_implies_are_drawn() -> None:
    imports = {"ground": frozenset[str](), "middle": frozenset({"ground"}), "top": frozenset({"middle", "ground"})}
    assert direct(imports)["top"] == {"middle"}
    assert floors_of(imports) == {"ground": 1, "middle": 2, "top": 3}


def test_an_arrow_passes_the_rooms_between_without_touching_them() -> None:
    at = {"top": (452.0, 44.0), "middle": (452.0, 172.0), "low": (452.0, 300.0)}
    assert path(at, "middle", "low") == "M540 246C540 280 540 264 540 298"
    past = path(at, "top", "low")
    (lane,) = re.findall(r" (\d+) 172V246C", past)
    assert int(lane) < 452 or int(lane) > 452 + 176
    assert past.startswith("M540 118C")
    assert past.endswith(" 540 298")
