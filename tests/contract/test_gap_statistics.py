"""Every number that decides something in the gap finder stands on its page, with the value that the code has.

Those that only cost time, memory or rounding stand in gap_numbers.txt.
"""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs/explanation/gap-statistics.md"
LIST = Path(__file__).with_name("gap_numbers.txt")
ROW = re.compile(r"^\| `([\w.]+\.[A-Z_]+)` \| ([-0-9.e+, ]+) \|", re.MULTILINE)


def shown(value: object) -> str | None:
    """A number, or numbers, as the page has them; None for what is none."""
    parts = value if isinstance(value, tuple) else (value,)
    if not parts or not all(isinstance(part, int | float) for part in parts):
        return None
    return ", ".join(f"{part:g}" for part in parts)


def constants() -> dict[str, str]:
    """Numbers in capitals of the gap finder's modules."""
    found = {}
    gap = REPOSITORY / "core/kilter_core/gap"
    for path in sorted(gap.rglob("[a-z]*.py")):
        place = ".".join(path.relative_to(gap).with_suffix("").parts)
        module = importlib.import_module(f"kilter_core.gap.{place}")
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            for target in targets:
                if isinstance(target, ast.Name) and target.id.isupper():
                    text = shown(getattr(module, target.id))
                    found |= {} if text is None else {f"{place}.{target.id}": text}
    return found


def test_every_number_has_its_row_and_value() -> None:
    text = PAGE.read_text(encoding="utf-8")
    scores = re.sub(r"<!-- blind scores: begin -->.*<!-- blind scores: end -->", "", text, flags=re.DOTALL)
    assert scores != text, "the page has no place for the scores"
    on_page = dict(ROW.findall(scores))
    listed = dict(line.split(" ", 1) for line in LIST.read_text(encoding="utf-8").splitlines())
    assert not set(on_page) & set(listed)
    assert on_page | listed == constants()


def test_every_threshold_says_what_it_decides_and_rests_on() -> None:
    section = PAGE.read_text(encoding="utf-8").split("## Thresholds")[1].split("## Half")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    assert len(rows) > 40
    assert all(len([cell for cell in row.strip("|").split("|") if cell.strip()]) == 4 for row in rows)
