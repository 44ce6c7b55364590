"""Whether views are enough to tell what a low-cost arm has: both sides, two payloads, joints moved and pulled both ways."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError
from kilter_files.ground.later import np
from kilter_files.rig.kit.loads import Limits, Pulled, Sought, count_gravity_directions, flange, format_examples
from kilter_files.rig.kit.sight import sights

FEWEST_VIEWS, FEWEST_POSES = 40, 20
LEAST_SHARE = 0.25  # of the views, from either side of a joint, and with either payload
LEAST_PAYLOAD_KG = 0.1  # between the lightest and the heaviest
LEAST_TRAVEL = 0.3  # of a joint's limits
LEAST_DEG = 0.5  # readings that differ by less are one pose


Row = Mapping[str, Any]
Rig = Mapping[str, Sequence[Mapping[str, Any]]]  # cameras and boards, as a campaign names them
NAMED = ("camera", "board")  # columns that may hold names


@dataclass(frozen=True)
class Capture:
    """What was seen: views, distinct poses, payloads kg, sentences on what is missing, and how gravity pulled the joints."""

    views: int
    poses: int
    payloads_kg: tuple[float, ...]
    missing: tuple[str, ...]
    pulled: tuple[Pulled, ...] = ()

    @property
    def untold(self) -> dict[int, str]:
        """Why the backlash of a joint, from 1, cannot be told."""
        return {one.joint: one.untold for one in self.pulled if one.untold}


def capture_from_files(
    files: Sequence[Path], joints: Sequence[Mapping[str, Any]], chain: Mapping[str, Any], rig: Rig
) -> Capture:
    """Look at views in files of ``kilter measure see``; ``joints`` as the server tells them, ``chain`` as it converts it.

    ``rig`` names ``cameras`` and ``boards`` as a campaign does.

    Raises:
        FileError: a file without the joints of the arm, or without corners.

    """
    return coverage([row for file in files for row in _rows(file, len(joints), rig)], joints, chain, rig)


def coverage(rows: Sequence[Row], joints: Sequence[Mapping[str, Any]], chain: Mapping[str, Any], rig: Rig) -> Capture:
    """Look at views of an arm: joints in degrees (``q1_deg`` ...), sides (``dir1`` ...), ``payload_kg``, None where empty.

    ``chain`` is its robot document of convention ``chain``, of which gravity's pull follows, and with the pixels of ``rig``
    where camera and board stand.
    """
    q = [[row[f"q{j + 1}_deg"] or 0.0 for j in range(len(joints))] for row in rows]
    poses = {tuple(round(value / LEAST_DEG) for value in row) for row in q}
    payloads = [row.get("payload_kg") for row in rows]
    known = tuple(sorted({value for value in payloads if value is not None}))
    held, limits = [value or 0.0 for value in payloads], [_limits(joint) for joint in joints]
    seen = np.array(q, dtype=float)
    sought = Sought(chain, seen, limits, lambda: sights(rows, flange(chain, seen), rig))
    loads = count_gravity_directions(sought, held) if rows else []
    missing = [
        *_counts(len(rows), len(poses)),
        *_loads(payloads, known),
        *_sides(rows, joints),
        *(_travel(one, joints[one[0]]["name"], sought if loads else None) for one in _short(q, limits)),
        *(one.missing for one in loads if one.missing),
    ]
    return Capture(len(rows), len(poses), known, tuple(missing), tuple(loads))


def coverage_columns(joints: int, rig: Rig) -> list[str]:
    """Columns that say something of coverage."""
    numbers = range(1, joints + 1)
    corners = range(1, 1 + max((len(board["corners_mm"]) for board in rig.get("boards") or []), default=1))
    pixels = [f"{axis}{k}_px" for k in corners for axis in "uv"]
    return [*(f"q{j}_deg" for j in numbers), *(f"dir{j}" for j in numbers), "payload_kg", *NAMED, *pixels]


def _rows(file: Path, joints: int, rig: Rig) -> Iterator[Row]:
    with file.open(encoding="utf-8", newline="") as lines:
        reader = csv.DictReader(lines)
        names = set(reader.fieldnames or ())
        needed = [*(f"q{j + 1}_deg" for j in range(joints)), "u1_px", "v1_px"]
        lacking = [name for name in needed if name not in names]
        if lacking:
            raise FileError(
                f"{file}: has no column {lacking[0]}. Give the views that `kilter measure see` writes as CSV, with "
                "the joints of "
                f"this arm ({joints}).",
                file=str(file),
            )
        told = coverage_columns(joints, rig)
        for row in reader:
            yield {
                name: row.get(name) if name in NAMED else _number(file, reader.line_num, name, row.get(name))
                for name in told
            }


def _number(file: Path, line: int, name: str, text: str | None) -> float | None:
    if text in (None, ""):
        if name.startswith("q"):
            raise FileError(f"{file}, line {line}: {name} is empty. Leave the view out, or fill it.", file=str(file))
        return None
    try:
        number = float(str(text))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise FileError(f"{file}, line {line}: {name} is {text!r}, not a number.", file=str(file))
    return number


def _counts(views: int, poses: int) -> Iterator[str]:
    if views < FEWEST_VIEWS:
        yield f"{FEWEST_VIEWS - views} views more ({views} of {FEWEST_VIEWS})"
    if poses < FEWEST_POSES:
        yield f"{FEWEST_POSES - poses} poses more ({poses} of {FEWEST_POSES})"


def _loads(payloads: Sequence[float | None], known: Sequence[float]) -> Iterator[str]:
    if None in payloads or not known:
        yield "the column payload_kg: what the gripper held in each view, 0 where nothing"
    elif known[-1] - known[0] < LEAST_PAYLOAD_KG:
        yield f"a second payload, at least {LEAST_PAYLOAD_KG * 1000:.0f} g heavier: sag is told from geometry by it"
    else:
        light = sum(value == known[0] for value in payloads) / len(payloads)
        if not LEAST_SHARE <= light <= 1.0 - LEAST_SHARE:
            yield f"views with {'the heavier' if light > 0.5 else 'the lighter'} payload: a quarter of them at least"


def _sides(rows: Sequence[Row], joints: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    for j, joint in enumerate(joints):
        sides = [row.get(f"dir{j + 1}") for row in rows]
        if None in sides:
            yield f"the column dir{j + 1}: from which side joint {j + 1} came, -1 or 1"
            continue
        up = sum(side == 1.0 for side in sides) / max(len(sides), 1)
        down = sum(side == -1.0 for side in sides) / max(len(sides), 1)
        if min(up, down) < LEAST_SHARE:
            side = "above" if down < up else "below"
            yield f"views in which joint {j + 1} ({joint['name']}) came from {side}: a quarter of them at least"


Short = tuple[int, float, float, float]  # joint from 0, its lowest and highest reading, how far it should move, deg


def _short(q: Sequence[Sequence[float]], limits: Limits) -> list[Short]:
    """Joints that moved too little."""
    found = []
    for j, pair in enumerate(limits if q else ()):
        least, most = min(row[j] for row in q), max(row[j] for row in q)
        if pair is not None and most - least < LEAST_TRAVEL * (pair[1] - pair[0]):
            found.append((j, least, most, LEAST_TRAVEL * (pair[1] - pair[0])))
    return found


def _travel(short: Short, name: str, sought: Sought | None) -> str:
    j, least, most, wanted = short
    told = f"motion of joint {j + 1} ({name}): it moved by {math.floor(most - least)} deg, {math.ceil(wanted)} would do"
    if sought is None or not sought.sights:
        return told
    examples, shown = sought.beyond(j, most - wanted, least + wanted)
    if examples:
        return f"{told}, for example near {format_examples(examples)}, where the camera sees the board"
    unseen = "; at no such pose does the camera see the board: move it, or fix the board to another side of the gripper"
    return told + (unseen if shown is False else "")


def _limits(joint: Mapping[str, Any]) -> tuple[float, float] | None:
    low, high = joint.get("limits_deg") or (None, None)
    return None if low is None or high is None else (float(low), float(high))
