"""Compare what two commits found: ``python -m tests.frozen.compare BEFORE AFTER [--within 1e-9]``. Exit 1 if they differ.

Bit for bit, or numbers within a share of the larger of two (of the largest number of their list, so that a residual near
zero is judged by its neighbours). Words, keys and lengths are always the same.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MOST_SHOWN = 20


def differences(before: Any, after: Any, within: float, place: str = "") -> Iterator[str]:
    """Yield where two results differ."""
    if isinstance(before, dict) and isinstance(after, dict):
        if before.keys() != after.keys():
            yield f"{place}: keys {sorted(before.keys() ^ after.keys())}"
        for key in before.keys() & after.keys():
            yield from differences(before[key], after[key], within, f"{place}.{key}")
    elif isinstance(before, list) and isinstance(after, list):
        yield from _lists(before, after, within, place)
    elif _number(before) and _number(after):
        if not _same(before, after, max(abs(before), abs(after)) * within):
            yield f"{place}: {before!r} became {after!r}"
    elif type(before) is not type(after) or before != after:
        yield f"{place}: {before!r} became {after!r}"


def _lists(before: list[Any], after: list[Any], within: float, place: str) -> Iterator[str]:
    if len(before) != len(after):
        yield f"{place}: {len(before)} became {len(after)}"
        return
    if before and all(map(_number, before)) and all(map(_number, after)):
        least = within * max((abs(v) for v in (*before, *after) if math.isfinite(v)), default=0.0)
        for k, (one, other) in enumerate(zip(before, after, strict=True)):
            if not _same(one, other, least):
                yield f"{place}[{k}]: {one!r} became {other!r}"
        return
    for k, (one, other) in enumerate(zip(before, after, strict=True)):
        yield from differences(one, other, within, f"{place}[{k}]")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _same(one: float, other: float, least: float) -> bool:
    return one == other or (one != one and other != other) or abs(one - other) <= least


def read(path: Path) -> dict[str, Any]:
    """Return the parts of a file by name."""
    return dict(json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())


def main() -> None:
    """Say where two files differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--within", type=float, default=0.0, help="share by which numbers may differ; 0: bit for bit")
    given = parser.parse_args()
    before, after = read(given.before), read(given.after)
    found = {}
    for name in sorted(before.keys() | after.keys()):
        if name not in before or name not in after:
            found[name] = [f"only in {'after' if name in after else 'before'}"]
        elif told := list(differences(before[name], after[name], given.within)):
            found[name] = told
    for name, told in found.items():
        print(f"{name}: {len(told)} differences")
        print("\n".join(f"  {line}" for line in told[:MOST_SHOWN]))
    how = f"within {given.within:g}" if given.within else "bit for bit"
    print(f"{len(before.keys() & after.keys()) - len(found)} of {len(before)} parts are the same, {how}.")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
