"""Whether views are enough to tell what a low-cost arm has, and what an identification says of it, in plain words."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import Any

from kilter_files.ground.errors import FileError
from kilter_files.ground.later import np
from kilter_files.rig.kit.loads import Limits, Pulled, Sought, count_gravity_directions, flange, format_examples
from kilter_files.rig.kit.sight import sights
from kilter_files.robots.exported import lists_of_export

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


SURE, WITHIN_95 = 3.0, 1.96  # standard deviations
FARTHEST_BELOW = 8.0  # standard deviations below 0, where the tail of a normal distribution is still a number
LEAST_BACKLASH_DEG, LEAST_SAG_DEG, LEAST_TICKS = 0.1, 0.1, 2
TICK_DEG = 360.0 / 4095.0
G = 9.81
HELD_KG = 0.2  # of which the words speak
REACH_M = 0.3  # how far away it is held


def result_sentences(
    result: Mapping[str, Any],
    joints: Sequence[Mapping[str, Any]],
    offsets: Sequence[Mapping[str, Any]],
    reach_m: float,
    untold: Mapping[int, str],
) -> list[str]:
    """Sentences, the largest first, then where no backlash was seen, and which zeros are not told.

    ``offsets`` are the zero offsets of an exported table (real less reading), ``reach_m`` where a load may be, ``untold``
    says why the backlash of a joint, from 1, is not to be told: its prior decides there, whatever the fit says.
    """
    stated = {str(one["name"]): one for one in result.get("parameters") or []}
    parameters = {name: one for name, one in stated.items() if name not in {f"backlash_load_{j}" for j in untold}}
    numbers = {str(joint["name"]): j for j, joint in enumerate(joints, 1)}
    zeros = [one for one in offsets if "offset_deg" in one and one["joint"] in numbers]
    found = [*_backlash(parameters, joints), *_sag(parameters, joints, reach_m), *_zeros(zeros, numbers, parameters)]
    told = (text for _, text in sorted(found, key=lambda one: -one[0]))
    return [*told, *_no_backlash(parameters, joints), *untold.values(), *_unknown_zero_sentences(zeros, numbers)]


def steps(robot: str) -> list[str]:
    """What to print, drive, photograph and ask for, one command or sentence each."""
    return [
        "kilter measure board --columns 5 --rows 4 --square-mm 15 -o board.pdf  # print and measure it, fix it to "
        "the gripper or table",
        "drive the arm to 40 poses or more with your own program, from both sides, with an empty gripper and with 200 g: take "
        "a picture at rest, and write readings, sides (dir1 ...) and payload_kg of each picture into joints.csv",
        "kilter measure see pictures --board board.json --joints joints.csv --intrinsics brown -o views.csv",
        f"kilter robot kit {robot} views.csv --cameras views.json --calibration my_arm.json",
        f"kilter activate latest --robot {robot}",
        f"lerobot-teleoperate --robot.type=kilter_so101 --robot.kilter_robot={robot} ...",
    ]


def describe_views(views: int, poses: int, payloads_kg: Sequence[float]) -> str:
    """How much was photographed."""
    held = ", ".join(f"{1000 * kg:g} g" for kg in payloads_kg)
    return f"{views} views of {poses} poses with {held or 'unknown payloads'}"


def describe_tool_error(before_mm: float | None, after_mm: float | None) -> str:
    """How far off the tool is, on views held out; 0.00 mm would be a perfect arm. None: it is not known, and why.

    What camera and board can make up for is not in it: where they stand is not known otherwise.
    """
    if before_mm is None or after_mm is None:
        return "how far off the tool is elsewhere is not known: no view was held out (kilter robot kit holds out each pose)"
    left = f"{after_mm:.{1 if after_mm >= 1.0 else 2}f} mm" if after_mm >= 0.005 else "less than 0.01 mm"
    return f"the tool is off by {before_mm:.1f} mm, corrected by {left} (views held out, camera and board where they fit best)"


NOTHING = "no joint has backlash, sag or a zero that shows in these views"


def result_summary(
    result: Mapping[str, Any], joints: Sequence[Mapping[str, Any]], table: bytes, untold: Mapping[int, str]
) -> dict[str, Any]:
    """What people are told of a result or a version; ``table`` is its export ``mdh-csv``, empty where there is none."""
    zeros = lists_of_export(table).get("zero_offsets", [])
    return {
        "lines": result_sentences(result, joints, zeros, REACH_M, untold),
        "zero_offsets": zeros,
        **held_out_errors(result),
        "warnings": [str(one["message"]) for one in result.get("warnings") or []],
    }


def held_out_errors(result: Mapping[str, Any]) -> dict[str, float | None]:
    """Mean error of the tool on views that were held out, mm: as it came, and with all that was found."""
    held = (result.get("metrics") or {}).get("validation") or {}
    stages = {"before_mm": "registration_only", "after_mm": "identified"}
    return {name: (held.get(stage) or {}).get("mean_mm") for name, stage in stages.items()}


def _significant_value(parameter: Mapping[str, Any] | None) -> float:
    """Value of a parameter that is surely there, else 0."""
    if parameter is None or parameter.get("value") is None:
        return 0.0
    value, sigma = float(parameter["value"]), parameter.get("sigma")
    return value if sigma is None or value > SURE * float(sigma) else 0.0


def _backlash(
    parameters: Mapping[str, Mapping[str, Any]], joints: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[float, str]]:
    for j, joint in enumerate(joints, 1):
        width = 2.0 * _significant_value(parameters.get(f"backlash_load_{j}"))
        if width >= LEAST_BACKLASH_DEG:
            yield width, f"joint {j} ({joint['name']}) has {width:.1f} deg of backlash"


def _no_backlash(parameters: Mapping[str, Mapping[str, Any]], joints: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Where backlash is not sure, with its 95 % interval: a width is never below 0, so neither is its interval.

    One that is surely below 0 contradicts the load, which rests a joint on one flank: something else changes with it.
    """
    for j, joint in enumerate(joints, 1):
        found = parameters.get(f"backlash_load_{j}")
        if found is None or found.get("value") is None or 2.0 * _significant_value(found) >= LEAST_BACKLASH_DEG:
            continue
        low, high = _width(found)
        name = f"joint {j} ({joint['name']})"
        if low is None or high is None:
            yield f"how well the backlash of {name} is known cannot be said"
        elif _significant_value({**found, "value": -float(found["value"])}) * 2.0 >= LEAST_BACKLASH_DEG:
            yield (
                f"{name}: no backlash seen; {-high:.1f} to {-low:.1f} deg (95 %) against the load instead: check "
                "payload_kg, and that the robot's base stands upright"
            )
        elif low > 0.0 and low + high < 2.0 * LEAST_BACKLASH_DEG:
            yield f"{name}: no backlash seen beyond a step of its reading (95 %: {low:.2f} to {high:.2f} deg)"
        elif low > 0.0:
            # One in forty such intervals leaves 0 out by chance, and an arm has several joints: that names none.
            yield f"{name}: whether it has backlash is not sure (95 %: {low:.2f} to {high:.2f} deg), more views would tell"
        else:
            most = max(high, _at_most(0.5 * (low + high), (high - low) / (2.0 * WITHIN_95)))
            within = f"95 %: 0 to {most:.2f} deg" if most >= 0.005 else "95 %: below 0.01 deg"
            yield f"{name}: no backlash seen ({within})"


def _at_most(value: float, sigma: float) -> float:
    """What a width is below with 95 %, known that it is not below 0: an estimate below 0 leaves more than nothing."""
    if sigma <= 0.0:
        return max(value, 0.0)
    normal, below = NormalDist(), max(value / sigma, -FARTHEST_BELOW)
    return sigma * (below - normal.inv_cdf(0.05 * normal.cdf(below)))


def _width(half: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """95 % interval of the width of which this parameter is half, deg."""
    low, high = _interval(half)
    return (None, None) if low is None or high is None else (2.0 * low, 2.0 * high)


def _interval(parameter: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """95 % interval of a parameter."""
    if parameter.get("lower") is not None and parameter.get("upper") is not None:
        return float(parameter["lower"]), float(parameter["upper"])
    if parameter.get("sigma") is None:
        return None, None
    spread = WITHIN_95 * float(parameter["sigma"])
    return float(parameter["value"]) - spread, float(parameter["value"]) + spread


def _sag(
    parameters: Mapping[str, Mapping[str, Any]], joints: Sequence[Mapping[str, Any]], reach_m: float
) -> Iterator[tuple[float, str]]:
    for j, joint in enumerate(joints, 1):
        compliance = _significant_value(parameters.get(f"compliance_{j}"))  # deg/(N m)
        sag = compliance * HELD_KG * G * reach_m
        if sag >= LEAST_SAG_DEG:
            held = f"{HELD_KG * 1000:.0f} g held {reach_m * 100:.0f} cm away from it"
            stiffness = _stiffness(parameters[f"compliance_{j}"])
            yield sag, f"joint {j} ({joint['name']}) sags by {sag:.1f} deg more with {held} ({stiffness})"


def _stiffness(compliance: Mapping[str, Any]) -> str:
    """Stiffness of a drive by its compliance, deg/(N m), with its 95 % interval where it has one: that of the compliance."""
    value, (low, high) = float(compliance["value"]), _interval(compliance)
    stiffest = None if low is None or low <= 0.0 else math.degrees(1.0) / low
    within = (
        f", 95 %: {math.degrees(1.0) / high:.0f} to {stiffest:.0f}" if stiffest is not None and high is not None else ""
    )
    return f"{math.degrees(1.0) / value:.0f} N m/rad{within}"


def _zeros(
    zeros: Sequence[Mapping[str, Any]], numbers: Mapping[str, int], parameters: Mapping[str, Any]
) -> Iterator[tuple[float, str]]:
    """Those whose interval leaves 0 out, with it."""
    for one in zeros:
        name, offset = str(one["joint"]), float(one["offset_deg"])
        ticks = round(offset / TICK_DEG)
        if one["state"] != "known" or abs(ticks) < LEAST_TICKS:
            continue
        half = float(one["half_width_deg"])
        low, high = abs(offset) - half, abs(offset) + half
        held = ", its sag at rest included" if f"compliance_{numbers[name]}" in parameters else ""
        steps = f"{abs(ticks)} ticks ({low / TICK_DEG:.0f} to {high / TICK_DEG:.0f}) of its homing offset (kilter robot homing)"
        digits = 1 if half >= 0.1 else 2
        within = f"95 %: {offset - half:+.{digits}f} to {offset + half:+.{digits}f}"
        yield (
            abs(offset),
            f"the zero of joint {numbers[name]} ({name}) is off by {offset:+.1f} deg ({within}){held}: {steps}",
        )


def _unknown_zero_sentences(zeros: Sequence[Mapping[str, Any]], numbers: Mapping[str, int]) -> Iterator[str]:
    """What nobody should write into a servo."""
    for one in zeros:
        number, name = numbers[str(one["joint"])], one["joint"]
        if one["state"] == "uncertain":
            half = float(one["half_width_deg"])
            within = f"known to ±{half:.1f} deg, {half / TICK_DEG:.0f} ticks"
            yield f"the zero of joint {number} ({name}) cannot be told apart from 0: {within}"
        elif one["state"] == "unstated":
            yield f"how well the zero of joint {number} ({name}) is known cannot be said"
        elif one["state"] == "shared":
            yield f"the zero of joint {number} ({name}) goes with other numbers of the table: do not enter it alone"
    held = [numbers[str(one["joint"])] for one in zeros if one["state"] == "held"]
    if held:
        which = "the zero of joint" if len(held) == 1 else "the zeros of joints"
        listed = " and ".join(filter(None, (", ".join(map(str, held[:-1])), str(held[-1]))))
        yield f"{which} {listed} cannot be told: shared with base or tool, or not identified"
