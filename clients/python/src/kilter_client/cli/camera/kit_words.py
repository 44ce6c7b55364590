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
    result: Mapping[str, Any], joints: Sequence[Mapping[str, Any]], offsets_deg: Mapping[str, float], reach_m: float
) -> list[str]:
    """Sentences, the largest first; ``offsets_deg`` are real less reading of each joint, ``reach_m`` where a load may be."""
    parameters = {str(one["name"]): one for one in result.get("parameters") or []}
    found = [*_backlash(parameters, joints), *_sag(parameters, joints, reach_m), *_zeros(offsets_deg, joints)]
    return [text for _, text in sorted(found, key=lambda one: -one[0])]


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


def _zeros(offsets_deg: Mapping[str, float], joints: Sequence[Mapping[str, Any]]) -> Iterator[tuple[float, str]]:
    numbers = {str(joint["name"]): j for j, joint in enumerate(joints, 1)}
    for name, offset in offsets_deg.items():
        ticks = round(offset / TICK_DEG)
        if abs(ticks) >= LEAST_TICKS and name in numbers:
            held = f"{abs(ticks)} ticks of its homing offset (kilter homing)"
            yield abs(offset), f"the zero of joint {numbers[name]} ({name}) is off by {offset:+.1f} deg: {held}"
