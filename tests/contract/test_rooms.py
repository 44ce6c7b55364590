"""The house that the core is: few rooms on few floors, every import downwards, and a page that shows it as it is."""

from __future__ import annotations

import pytest

from tools.draw_rooms import direct, floors_of, imports_of_rooms, written

MOST_ROOMS, MOST_FLOORS = 17, 8


def test_the_core_has_few_rooms_on_few_floors() -> None:
    floors = floors_of(imports_of_rooms())
    assert len(floors) <= MOST_ROOMS
    assert max(floors.values()) <= MOST_FLOORS


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
