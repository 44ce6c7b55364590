"""Draw the rooms of the core from its imports: ``python -m tools.draw_rooms [--check]``.

Writes ``docs/images/core-rooms.svg`` and the table in ``docs/explanation/architecture.md``. A room stands one floor above
the highest room that it imports; an arrow goes to what a room imports and does not reach through another room.
"""

from __future__ import annotations

import ast
import re
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path

import grimp

from tools.draw_pictures import BLUE, IMAGES, INK, arrow, box, picture, text

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "kilter_core"
CORE = ROOT / "core" / PACKAGE
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
PICTURE = IMAGES / "core-rooms.svg"
BEGIN, END = "<!-- rooms: begin -->", "<!-- rooms: end -->"
WIDTH, BOX_WIDTH, BOX_HEIGHT, FLOOR_HEIGHT, MARGIN = 1080, 176, 74, 128, 40
LINE = 25  # characters of a line in a box
TITLE = "Rooms of the core: each imports only rooms on floors below it"

Imports = Mapping[str, frozenset[str]]


def imports_of_rooms() -> Imports:
    """Which rooms each room imports."""
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    rooms = sorted(child.removeprefix(f"{PACKAGE}.") for child in graph.find_children(PACKAGE))
    out: dict[str, set[str]] = {room: set() for room in rooms}
    for module in graph.modules - {PACKAGE}:
        for other in graph.find_modules_directly_imported_by(module) - {PACKAGE}:
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


def purpose(room: str) -> str:
    """First sentence of a room's docstring."""
    path = CORE / room / "__init__.py"
    source = path if path.exists() else CORE / f"{room}.py"
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


def drawing(imports: Imports) -> str:
    """The picture as SVG."""
    floors, below = floors_of(imports), direct(imports)
    at = places(floors, below)
    parts = [text(WIDTH / 2, 26, TITLE, size=15, weight=600)]
    for room, others in sorted(below.items()):
        for other in sorted(others):
            x0, y0 = at[room][0] + BOX_WIDTH / 2, at[room][1] + BOX_HEIGHT
            x1, y1 = at[other][0] + BOX_WIDTH / 2, at[other][1] - 2
            parts.append(arrow(f"M{x0:.0f} {y0:.0f}C{x0:.0f} {y0 + 34:.0f} {x1:.0f} {y1 - 34:.0f} {x1:.0f} {y1:.0f}"))
    for room, (x, y) in sorted(at.items()):
        words = textwrap.wrap(re.split("[:,.;]", purpose(room))[0], LINE)[:2]
        parts.append(box(round(x), round(y), BOX_WIDTH, BOX_HEIGHT, room, words, BLUE if floors[room] > 2 else INK))
    return picture(WIDTH, 44 + max(floors.values()) * FLOOR_HEIGHT, TITLE, parts)


def table(imports: Imports) -> str:
    """The rooms as a table, from the highest floor down."""
    floors = floors_of(imports)
    rows = ["| floor | room | what it is | imports |", "|---|---|---|---|"]
    for room in sorted(floors, key=lambda room: (-floors[room], room)):
        others = ", ".join(f"`{other}`" for other in sorted(imports[room], key=lambda o: (-floors[o], o)))
        rows.append(f"| {floors[room]} | `{room}` | {purpose(room)} | {others} |")
    return "\n".join(rows)


def written() -> dict[Path, str]:
    """What stands in each file when it is up to date."""
    imports = imports_of_rooms()
    head, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    tail = rest.partition(END)[2]
    return {PICTURE: drawing(imports), PAGE: f"{head}{BEGIN}\n{table(imports)}\n{END}{tail}"}


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
