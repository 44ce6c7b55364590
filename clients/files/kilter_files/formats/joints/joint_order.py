"""Which joint of a log is the first of the arm: messages name their joints in any order, often alphabetically."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from kilter_files.ground.faults import fault
from kilter_files.ground.names import did_you_mean

NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")
# Universal Robots' joints, which drivers publish by the alphabet: elbow first
KNOWN = (
    ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)


def joints_in_arm_order(path: Path, names: Sequence[str], wanted: Sequence[str]) -> list[str]:
    """Return ``names`` from the first joint to the last: as ``wanted``, by their numbers, or as known of their maker.

    Raises:
        FileError: a wanted joint is not there, or nothing says the order.

    """
    if wanted:
        for name in wanted:
            if name not in names:
                remedy = f"The log has {', '.join(names)}."
                raise fault(path, f"has no joint {name!r}{did_you_mean(name, names)}", remedy)
        return list(wanted)
    found = by_name(names)
    if found is None:
        what = f"nothing says which of its joints is the first ({', '.join(names)})"
        raise fault(path, what, "Name the arm's joints from the base to the tool (--joint-order a,b,c).")
    return found


def by_name(names: Sequence[str]) -> list[str] | None:
    """Return the order that the names themselves tell, None when they tell none."""
    parts = [NUMBERED.fullmatch(name) for name in names]
    alike = {(m[1], m[3]) for m in parts if m}
    numbers = [int(m[2]) for m in parts if m]
    if len(alike) == 1 and len(set(numbers)) == len(names):
        return [name for _, name in sorted(zip(numbers, names, strict=True))]
    for known in KNOWN:
        prefix = next((name.removesuffix(known[0]) for name in names if name.endswith(known[0])), None)
        if prefix is not None and set(names) == {prefix + name for name in known}:
            return [prefix + name for name in known]
    return [names[0]] if len(names) == 1 else None
