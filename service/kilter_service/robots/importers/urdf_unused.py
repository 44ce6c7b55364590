"""Values of a joint in a URDF that say more of its readings or range than the arm takes from it, in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from xml.etree.ElementTree import Element

SOFT = ("soft_lower_limit", "soft_upper_limit")


def unused_values(element: Element, kind: str) -> tuple[str, ...]:
    """Return a sentence for each value of a moving joint that is not used though it changes what its numbers mean."""
    name = str(element.get("name"))
    return (*_calibration(name, kind, element), *_limits(name, kind, element), *_soft_limits(name, kind, element))


def _calibration(name: str, kind: str, element: Element) -> Iterator[str]:
    for tag in element.findall("calibration"):
        values = [(edge, _value(tag, edge)) for edge in ("rising", "falling", "reference_position")]
        said = ", ".join(f"{edge} {_length_or_angle(value, kind)}" for edge, value in values if value)
        if said:
            yield f"{name}: <calibration> ({said}) is not used. An identification finds zero offsets by itself"


def _limits(name: str, kind: str, element: Element) -> Iterator[str]:
    limit = element.find("limit")
    if limit is None or kind == "continuous":
        return
    lower, upper = _value(limit, "lower") or 0.0, _value(limit, "upper") or 0.0
    said = f"lower {_length_or_angle(lower, kind)}, upper {_length_or_angle(upper, kind)}"
    if lower > upper:
        yield f"{name}: its limits are swapped ({said}) and are not used. Exchange them in the file"
    elif lower == upper:
        yield f"{name}: its limits leave no range ({said}) and are not used"
    elif math.isfinite(lower) != math.isfinite(upper):
        yield f"{name}: a limit on one side only ({said}) is not used"


def _soft_limits(name: str, kind: str, element: Element) -> Iterator[str]:
    safety = element.find("safety_controller")
    ends = [] if safety is None else [(end.split("_")[1], _value(safety, end)) for end in SOFT]
    if any(value for _, value in ends):
        said = ", ".join(f"{end} {_length_or_angle(value, kind)}" for end, value in ends if value is not None)
        yield f"{name}: soft limits of its <safety_controller> ({said}) are not used, its <limit> is"


def _value(element: Element, attribute: str) -> float | None:
    """Return a number of the file; None where there is none."""
    try:
        return float(element.get(attribute, ""))
    except ValueError:
        return None


def _length_or_angle(value: float, kind: str) -> str:
    return f"{1e3 * value:.6g} mm" if kind == "prismatic" else f"{math.degrees(value):.6g} deg"
