"""Draw the rooms of the packages from their imports: ``python -m tools.draw_rooms [--check]``.

Writes pictures in ``docs/images`` and tables in ``docs/explanation/architecture.md``. A room stands one floor above the
highest room that it imports; an arrow goes to what a room imports and does not reach through another room. Each folder
is a room, which its docstring describes; in the client a room has several folders and modules: those between two
floors of the import contract that ``pyproject.toml`` names with what each room is for.
"""

from __future__ import annotations

import ast
import re
import sys
import textwrap
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import grimp

from tools.draw_pictures import BLUE, IMAGES, INK, arrow, box, picture, text

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
WIDTH, BOX_WIDTH, BOX_HEIGHT, FLOOR_HEIGHT, MARGIN = 1080, 176, 74, 128, 40
ENTRY = "__main__"  # where Python enters a package: it imports whatever the command asks for, and is no room
LINE = 25  # characters of a line in a box
CLEAR = 16  # between a box and an arrow that passes it

Imports = Mapping[str, frozenset[str]]


@dataclass(frozen=True)
class House:
    """A package whose rooms are drawn: where it is, what its picture and its table are called, its import contract."""

    package: str
    folder: Path
    name: str
    contract: str

    @property
    def picture(self) -> Path:
        """The file of its picture."""
        return IMAGES / f"{self.contract}.svg"

    @property
    def title(self) -> str:
        """What stands over its picture."""
        return f"Rooms of the {self.name}: each imports only rooms on floors below it"

    @property
    def marks(self) -> tuple[str, str]:
        """What stands around its table in the page."""
        return f"<!-- rooms of the {self.name}: begin -->", f"<!-- rooms of the {self.name}: end -->"


CORE = House("kilter_core", ROOT / "core" / "kilter_core", "core", "core-rooms")
SERVICE = House("kilter_service", ROOT / "service" / "kilter_service", "service", "service-rooms")
FILES = House("kilter_files", ROOT / "clients" / "files" / "kilter_files", "readers of files", "files-rooms")
CLIENT = House("kilter_client", ROOT / "clients" / "python" / "src" / "kilter_client", "client", "client-rooms")
HOUSES = (CORE, SERVICE, FILES, CLIENT)


@dataclass(frozen=True)
class Room:
    """What a room is for, and the folders and modules it has, the highest first."""

    purpose: str
    holds: tuple[str, ...]


@cache
def settings() -> dict[str, Any]:
    """The tools' part of ``pyproject.toml``."""
    tools: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    return tools


def imports_of_units(house: House) -> Imports:
    """Which folders and modules each folder or module of a package imports, also inside functions and for types only."""
    imports = imports_in(graph_of(house), house.package)
    return {unit: others for unit, others in imports.items() if unit != ENTRY}


@cache
def graph_of(house: House) -> grimp.ImportGraph:
    """All imports between the modules of a package."""
    return grimp.build_graph(house.package, cache_dir=None)


def imports_in(graph: grimp.ImportGraph, package: str) -> Imports:
    """Which folders and modules each folder or module directly inside a package, or a folder of one, imports of these."""
    out: dict[str, set[str]] = {child.removeprefix(f"{package}."): set() for child in graph.find_children(package)}
    depth = package.count(".") + 1
    for module in graph.find_descendants(package):
        for other in graph.find_modules_directly_imported_by(module):
            if other.startswith(f"{package}."):
                out[module.split(".")[depth]].add(other.split(".")[depth])
    return {unit: frozenset(others - {unit}) for unit, others in sorted(out.items())}


def floors_of_contract(house: House) -> list[str]:
    """The floors that the import contract of a package names, the highest first: units with ``|`` between them."""
    (found,) = (one for one in settings()["importlinter"]["contracts"] if one["id"] == house.contract)
    floors: list[str] = found["layers"]
    return floors


def rooms_of(house: House) -> dict[str, Room]:
    """The rooms of a package, the highest first.

    Raises:
        ValueError: the floor that a room begins with is not in the contract, or not below the room before.

    """
    floors = floors_of_contract(house)
    described = settings()["kilter"]["rooms"].get(house.package)
    if described is None:
        units = [unit for floor in floors for unit in floor.split(" | ") if unit != ENTRY]
        return {unit: Room(purpose(house, unit), (unit,)) for unit in units}
    first = [floors.index(room["from"]) if room["from"] in floors else -1 for room in described.values()]
    if first != sorted(set(first)) or first[0] != 0:
        raise ValueError(f"The rooms of {house.package} do not begin with floors of its contract, the highest first.")
    out = {}
    for (name, room), begin, end in zip(described.items(), first, [*first[1:], len(floors)], strict=True):
        holds = tuple(unit for floor in floors[begin:end] for unit in floor.split(" | "))
        out[name] = Room(room["is"], holds)
    return out


def imports_of_rooms(house: House) -> Imports:
    """Which rooms each room of a package imports."""
    return between(imports_of_units(house), rooms_of(house))


def between(imports: Imports, rooms: Mapping[str, Room]) -> Imports:
    """Which rooms each room imports, from what each folder and module imports.

    Raises:
        ValueError: a folder or module is in no room.

    """
    room_of = {unit: name for name, room in rooms.items() for unit in room.holds}
    if imports.keys() - room_of.keys():
        missing = ", ".join(sorted(imports.keys() - room_of.keys()))
        raise ValueError(f"The contract in pyproject.toml has no floor for {missing}: give each one.")
    out: dict[str, set[str]] = {name: set() for name in sorted(rooms)}
    for unit, others in imports.items():
        out[room_of[unit]] |= {room_of[other] for other in others}
    return {name: frozenset(others - {name}) for name, others in out.items()}


def floors_of(imports: Imports) -> dict[str, int]:
    """Floor of each room, 1 on the ground.

    Raises:
        ValueError: rooms that import each other in a circle.

    """
    floors: dict[str, int] = {}
    while len(floors) < len(imports):
        ready = [room for room in imports if room not in floors and imports[room] <= floors.keys()]
        if not ready:
            raise ValueError(
                f"Rooms import each other in a circle: {', '.join(sorted(imports.keys() - floors.keys()))}."
            )
        floors |= {room: 1 + max((floors[other] for other in imports[room]), default=0) for room in ready}
    return floors


def direct(imports: Imports) -> dict[str, frozenset[str]]:
    """The imports that do not follow from others."""

    def below(room: str) -> frozenset[str]:
        return imports[room].union(*(below(other) for other in imports[room]))

    return {room: frozenset(o for o in own if not any(o in below(p) for p in own)) for room, own in imports.items()}


def purpose(house: House, unit: str) -> str:
    """First sentence of a folder's or module's docstring."""
    path = house.folder / unit / "__init__.py"
    source = path if path.exists() else house.folder / f"{unit}.py"
    words = ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""
    return " ".join(words.split("\n\n")[0].split()).rstrip(".")


def places(floors: Mapping[str, int], below: Mapping[str, frozenset[str]]) -> dict[str, tuple[float, float]]:
    """Upper left corner of each room's box: a floor's rooms side by side, each over what it imports."""
    at: dict[str, tuple[float, float]] = {}
    top = max(floors.values())
    for floor in range(1, top + 1):
        rooms = [room for room in floors if floors[room] == floor]

        def over(room: str) -> float:
            centres = [at[other][0] for other in below[room]]
            return sum(centres) / len(centres) if centres else WIDTH / 2

        rooms.sort(key=lambda room: (over(room), room))
        step = (WIDTH - 2 * MARGIN) / len(rooms)
        for k, room in enumerate(rooms):
            at[room] = (MARGIN + step * (k + 0.5) - BOX_WIDTH / 2, 44 + (top - floor) * FLOOR_HEIGHT)
    return at


def path(at: Mapping[str, tuple[float, float]], room: str, other: str) -> str:
    """SVG path from a room down to another; past the floors between them it goes where no box is."""
    x0, y0 = at[room][0] + BOX_WIDTH / 2, at[room][1] + BOX_HEIGHT
    x1, y1 = at[other][0] + BOX_WIDTH / 2, at[other][1] - 2
    passed = [(x, y) for x, y in at.values() if y0 < y < at[other][1]]
    free = [
        x
        for x in range(MARGIN, WIDTH - MARGIN, 4)
        if all(not -CLEAR < x - left < BOX_WIDTH + CLEAR for left, _ in passed)
    ]
    if not passed or not free:
        return f"M{x0:.0f} {y0:.0f}C{x0:.0f} {y0 + 34:.0f} {x1:.0f} {y1 - 34:.0f} {x1:.0f} {y1:.0f}"
    lane = min(free, key=lambda x: (abs(x - x0) + abs(x - x1), abs(x - x1)))
    top, end = min(y for _, y in passed), max(y for _, y in passed) + BOX_HEIGHT
    return (
        f"M{x0:.0f} {y0:.0f}C{x0:.0f} {y0 + 34:.0f} {lane:.0f} {top - 34:.0f} {lane:.0f} {top:.0f}V{end:.0f}"
        f"C{lane:.0f} {end + 34:.0f} {x1:.0f} {y1 - 34:.0f} {x1:.0f} {y1:.0f}"
    )


def drawing(house: House, rooms: Mapping[str, Room], imports: Imports) -> str:
    """The picture as SVG."""
    floors, below = floors_of(imports), direct(imports)
    at = places(floors, below)
    parts = [text(WIDTH / 2, 26, house.title, size=15, weight=600)]
    parts += [arrow(path(at, room, other)) for room, others in sorted(below.items()) for other in sorted(others)]
    for room, (x, y) in sorted(at.items()):
        words = textwrap.wrap(re.split("[:,.;]", rooms[room].purpose)[0], LINE)[:2]
        parts.append(box(round(x), round(y), BOX_WIDTH, BOX_HEIGHT, room, words, BLUE if floors[room] > 2 else INK))
    return picture(WIDTH, 44 + max(floors.values()) * FLOOR_HEIGHT, house.title, parts)


def table(rooms: Mapping[str, Room], imports: Imports) -> str:
    """The rooms as a table, from the highest floor down; what a room holds, where that is more than the room itself."""
    floors = floors_of(imports)
    several = any(room.holds != (name,) for name, room in rooms.items())
    heads = ["floor", "room", "what it is", *(["folders and modules"] if several else []), "imports"]
    rows = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for name in sorted(floors, key=lambda name: (-floors[name], name)):
        others = ", ".join(f"`{other}`" for other in sorted(imports[name], key=lambda o: (-floors[o], o)))
        holds = [", ".join(f"`{unit}`" for unit in rooms[name].holds)] if several else []
        cells = [str(floors[name]), f"`{name}`", rooms[name].purpose, *holds, others]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def written() -> dict[Path, str]:
    """What stands in each file when it is up to date."""
    out, page = {}, PAGE.read_text(encoding="utf-8")
    for house in HOUSES:
        rooms, imports = rooms_of(house), imports_of_rooms(house)
        begin, end = house.marks
        head, _, rest = page.partition(begin)
        page = f"{head}{begin}\n{table(rooms, imports)}\n{end}{rest.partition(end)[2]}"
        out[house.picture] = drawing(house, rooms, imports)
    return out | {PAGE: page}


def main(arguments: list[str]) -> int:
    """Write the files, or say with ``--check`` which differ."""
    stale = [
        path for path, words in written().items() if not path.exists() or path.read_text(encoding="utf-8") != words
    ]
    if "--check" in arguments:
        for path in stale:
            name = path.relative_to(ROOT)
            print(f"{name} does not show the imports as they are: run `python -m tools.draw_rooms`.", file=sys.stderr)
        return 1 if stale else 0
    for path, words in written().items():
        path.write_text(words, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
