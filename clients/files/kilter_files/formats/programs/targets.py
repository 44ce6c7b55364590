"""Joint targets in robot programs, and the one list of their dialects.

A new dialect is one more line in ``DIALECTS`` and a module with its reader.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from kilter_files.formats.programs import target_fanuc, target_krl, target_rapid, target_urscript
from kilter_files.formats.programs.target_list import Targets
from kilter_files.ground.faults import fault, head_of
from kilter_files.ground.text_layout import encoding_of

__all__ = ["DIALECTS", "Dialect", "Targets", "dialect_of", "read_targets"]

MOST_BYTES = 16 << 20
LOOKED_AT = 1 << 18


@dataclass(frozen=True)
class Dialect:
    """A language of robots: what shows it in a text, its reader, and how joints of its poses become known."""

    sign: re.Pattern[str]
    read: Callable[[Path, str, Targets], None]
    remedy: str


def _dialect(sign: str, read: Callable[[Path, str, Targets], None], remedy: str) -> Dialect:
    return Dialect(re.compile(sign, re.M | re.I), read, remedy)


# in the order in which they are tried
DIALECTS: dict[str, Dialect] = {
    "RAPID": _dialect(
        target_rapid.SIGN, target_rapid.read, "Store jointtargets: CJointT() reads the joints where the arm stands"
    ),
    "FANUC LS": _dialect(target_fanuc.SIGN, target_fanuc.read, "Show the positions as joints on the pendant (REPRE)"),
    "KRL": _dialect(target_krl.SIGN, target_krl.read, "Store E6AXIS: $AXIS_ACT holds the joints where the arm stands"),
    "URScript": _dialect(
        target_urscript.SIGN, target_urscript.read, "Give movej joints: get_actual_joint_positions() reads them"
    ),
}  # fmt: skip


def dialect_of(path: Path) -> str | None:
    """Return whose program a text is by its content, None when it holds no joint targets."""
    head = head_of(path, LOOKED_AT)
    if b"\0" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return None
    text = head.decode(encoding_of(path, head), "replace")
    return next((name for name, dialect in DIALECTS.items() if dialect.sign.search(text)), None)


def read_targets(path: Path) -> Targets:
    """Read the joint targets of a program, in the order in which it moves to them, else as they are declared.

    Raises:
        FileError: no targets, one with other than six numbers, or poses only.

    """
    name = dialect_of(path)
    if name is None:
        raise fault(path, "holds no joint targets", f"{', '.join(DIALECTS)} are understood.")
    content = head_of(path, MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise fault(path, f"is larger than {MOST_BYTES >> 20} MB", "Is it a program?")
    text = content.decode(encoding_of(path, content), "replace").removeprefix("\ufeff")
    found = Targets(name)
    DIALECTS[name].read(path, text, found)
    _check(path, found)
    found.notes.insert(0, f"{name}: {len(found.joints_deg)} joint targets, in degrees")
    if found.poses:
        said = f"{len(found.poses)} targets are left out because they are poses without joints: {found.poses_said()}"
        found.warnings.append(said)
    return found


def _check(path: Path, found: Targets) -> None:
    if not found.joints_deg and found.poses:
        what = f"holds poses and no joints: {found.poses_said()}"
        raise fault(path, what, f"{DIALECTS[found.dialect].remedy}.", line=found.poses[0][1])
    if not found.joints_deg:
        raise fault(path, f"holds no joint targets of {found.dialect}", "Give joint targets, not poses.")
    odd = next((i for i, q in enumerate(found.joints_deg) if len(q) != len(found.joints_deg[0])), None)
    if odd is not None:
        what = f"{found.names[odd]} has {len(found.joints_deg[odd])} joints, the first {len(found.joints_deg[0])}"
        raise fault(path, what, "Give the targets of one arm.", line=found.lines[odd])
