"""Draw the rooms of the packages from their imports: ``python -m tools.draw_rooms [--check]``.

Writes ``docs/images/core-rooms.svg`` and its kin, and the tables in ``docs/explanation/architecture.md``. A room stands one
floor above the highest room that it imports; an arrow goes to what a room imports and does not reach through another room.
"""

from __future__ import annotations

import ast
import re
import sys
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import grimp

from tools.draw_pictures import BLUE, IMAGES, INK, arrow, box, picture, text

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
WIDTH, BOX_WIDTH, BOX_HEIGHT, FLOOR_HEIGHT, MARGIN = 1080, 176, 74, 128, 40
LINE = 25  # characters of a line in a box

Imports = Mapping[str, frozenset[str]]


@dataclass(frozen=True)
class House:
    """A package with rooms: its folder, what the picture calls it, and the name of the picture and of the marks."""

    package: str
    folder: Path
    what: str
    name: str

    @property
    def title(self) -> str:
        """Heading of the picture."""
        return f"Rooms of {self.what}: each imports only rooms on floors below it"

    @property
    def picture(self) -> Path:
        """Where the picture is written."""
        return IMAGES / f"{self.name}-rooms.svg"

    @property
    def marks(self) -> tuple[str, str]:
        """Where the table begins and ends on the page."""
        return f"<!-- rooms of {self.name}: begin -->", f"<!-- rooms of {self.name}: end -->"


CORE = House("kilter_core", ROOT / "core" / "kilter_core", "the core", "core")
FILES = House("kilter_files", ROOT / "clients" / "files" / "kilter_files", "the readers of files", "files")
HOUSES = (CORE, FILES)


def imports_of_rooms(house: House) -> Imports:
    """Which rooms each room imports."""
    package = house.package
    graph = grimp.build_graph(package, cache_dir=None)
    rooms = sorted(child.removeprefix(f"{package}.") for child in graph.find_children(package))
    out: dict[str, set[str]] = {room: set() for room in rooms}
    for module in graph.modules - {package}:
        for other in graph.find_modules_directly_imported_by(module) - {package}:
            out[module.split(".")[1]].add(other.split(".")[1])
    return {room: frozenset(others - {room}) for room, others in out.items()}


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


def purpose(house: House, room: str) -> str:
    """First sentence of a room's docstring."""
    path = house.folder / room / "__init__.py"
    source = path if path.exists() else house.folder / f"{room}.py"
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


def drawing(house: House, imports: Imports) -> str:
    """The picture as SVG."""
    floors, below = floors_of(imports), direct(imports)
    at = places(floors, below)
    parts = [text(WIDTH / 2, 26, house.title, size=15, weight=600)]
    for room, others in sorted(below.items()):
        for other in sorted(others):
            x0, y0 = at[room][0] + BOX_WIDTH / 2, at[room][1] + BOX_HEIGHT
            x1, y1 = at[other][0] + BOX_WIDTH / 2, at[other][1] - 2
            parts.append(arrow(f"M{x0:.0f} {y0:.0f}C{x0:.0f} {y0 + 34:.0f} {x1:.0f} {y1 - 34:.0f} {x1:.0f} {y1:.0f}"))
    for room, (x, y) in sorted(at.items()):
        words = textwrap.wrap(re.split("[:,.;]", purpose(house, room))[0], LINE)[:2]
        parts.append(box(round(x), round(y), BOX_WIDTH, BOX_HEIGHT, room, words, BLUE if floors[room] > 2 else INK))
    return picture(WIDTH, 44 + max(floors.values()) * FLOOR_HEIGHT, house.title, parts)


def table(house: House, imports: Imports) -> str:
    """The rooms as a table, from the highest floor down."""
    floors = floors_of(imports)
    rows = ["| floor | room | what it is | imports |", "|---|---|---|---|"]
    for room in sorted(floors, key=lambda room: (-floors[room], room)):
        others = ", ".join(f"`{other}`" for other in sorted(imports[room], key=lambda o: (-floors[o], o)))
        rows.append(f"| {floors[room]} | `{room}` | {purpose(house, room)} | {others} |")
    return "\n".join(rows)


def written() -> dict[Path, str]:
    """What stands in each file when it is up to date."""
    page, out = PAGE.read_text(encoding="utf-8"), {}
    for house in HOUSES:
        imports, (begin, end) = imports_of_rooms(house), house.marks
        head, _, rest = page.partition(begin)
        page = f"{head}{begin}\n{table(house, imports)}\n{end}{rest.partition(end)[2]}"
        out[house.picture] = drawing(house, imports)
    return {**out, PAGE: page}


def main(arguments: list[str]) -> int:
    """Write the files, or say with ``--check`` which differ."""
    stale = [
        path for path, words in written().items() if not path.exists() or path.read_text(encoding="utf-8") != words
    ]
    if "--check" in arguments:
        for path in stale:
            print(f"{path.relative_to(ROOT)} does not show the imports as they are: run `make rooms`.", file=sys.stderr)
        return 1 if stale else 0
    for path, words in written().items():
        path.write_text(words, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
