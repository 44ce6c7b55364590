"""What an identification says of a low-cost arm, in plain words: backlash, sag, zeros in ticks, and what is left."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import NormalDist
from typing import Any

from kilter_files.robots.exported import lists_of_export

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
