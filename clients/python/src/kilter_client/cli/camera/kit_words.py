"""What an identification says of a low-cost arm, in plain words: backlash, sag, zeros in ticks, and what is left."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

SURE = 3.0  # standard deviations
LEAST_BACKLASH_DEG, LEAST_SAG_DEG, LEAST_TICKS = 0.1, 0.1, 2
TICK_DEG = 360.0 / 4095.0
G = 9.81
HELD_KG = 0.2  # of which the words speak


def lines_of(
    result: Mapping[str, Any], joints: Sequence[Mapping[str, Any]], offsets: Sequence[Mapping[str, Any]], reach_m: float
) -> list[str]:
    """Sentences, the largest first, then which zeros are not told.

    ``offsets`` are the zero offsets of an exported table (real less reading), ``reach_m`` where a load may be.
    """
    parameters = {str(one["name"]): one for one in result.get("parameters") or []}
    numbers = {str(joint["name"]): j for j, joint in enumerate(joints, 1)}
    zeros = [one for one in offsets if "offset_deg" in one and one["joint"] in numbers]
    found = [
        *_backlash(parameters, joints), *_sag(parameters, joints, reach_m), *_zeros(zeros, numbers, parameters)
    ]  # fmt: skip
    return [*(text for _, text in sorted(found, key=lambda one: -one[0])), *_not_told(zeros, numbers)]


def errors_of(result: Mapping[str, Any]) -> dict[str, float | None]:
    """Mean error of the tool on views that were held out, mm: as it came, and with all that was found."""
    held = (result.get("metrics") or {}).get("validation") or {}
    stages = {"before_mm": "registration_only", "after_mm": "identified"}
    return {name: (held.get(stage) or {}).get("mean_mm") for name, stage in stages.items()}


def _sure(parameter: Mapping[str, Any] | None) -> float:
    """Value of a parameter that is surely there, else 0."""
    if parameter is None:
        return 0.0
    value, sigma = float(parameter["value"]), parameter.get("sigma")
    return value if sigma is None or value > SURE * float(sigma) else 0.0


def _backlash(
    parameters: Mapping[str, Mapping[str, Any]], joints: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[float, str]]:
    for j, joint in enumerate(joints, 1):
        width = 2.0 * _sure(parameters.get(f"backlash_load_{j}"))
        if width >= LEAST_BACKLASH_DEG:
            yield width, f"joint {j} ({joint['name']}) has {width:.1f} deg of backlash"


def _sag(
    parameters: Mapping[str, Mapping[str, Any]], joints: Sequence[Mapping[str, Any]], reach_m: float
) -> Iterator[tuple[float, str]]:
    for j, joint in enumerate(joints, 1):
        compliance = _sure(parameters.get(f"compliance_{j}"))  # deg/(N m)
        sag = compliance * HELD_KG * G * reach_m
        if sag >= LEAST_SAG_DEG:
            stiffness = math.degrees(1.0) / compliance
            held = f"{HELD_KG * 1000:.0f} g held {reach_m * 100:.0f} cm away from it ({stiffness:.0f} N m/rad)"
            yield sag, f"joint {j} ({joint['name']}) sags by {sag:.1f} deg more with {held}"


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
        steps = (
            f"{abs(ticks)} ticks ({low / TICK_DEG:.0f} to {high / TICK_DEG:.0f}) of its homing offset (kilter homing)"
        )
        within = f"95 %: {offset - half:+.1f} to {offset + half:+.1f}"
        yield (
            abs(offset),
            f"the zero of joint {numbers[name]} ({name}) is off by {offset:+.1f} deg ({within}){held}: {steps}",
        )


def _not_told(zeros: Sequence[Mapping[str, Any]], numbers: Mapping[str, int]) -> Iterator[str]:
    """What nobody should write into a servo."""
    for one in zeros:
        number, name = numbers[str(one["joint"])], one["joint"]
        if one["state"] == "uncertain":
            half = float(one["half_width_deg"])
            within = f"known to ±{half:.1f} deg, {half / TICK_DEG:.0f} ticks"
            yield f"the zero of joint {number} ({name}) cannot be told apart from 0: {within}"
        elif one["state"] == "unstated":
            yield f"how well the zero of joint {number} ({name}) is known cannot be said"
    held = [numbers[str(one["joint"])] for one in zeros if one["state"] == "held"]
    if held:
        which = "the zero of joint" if len(held) == 1 else "the zeros of joints"
        listed = " and ".join(filter(None, (", ".join(map(str, held[:-1])), str(held[-1]))))
        yield f"{which} {listed} cannot be told: shared with base or tool, or not identified"
