"""How the curve of an effect over its own quantity is called: on the page, in reports and in files of figures alike."""

from __future__ import annotations

from collections.abc import Sequence

from kilter_service.contract.effect_curves import EffectCurve
from kilter_service.contract.gap_details import AtJoints

SIDES = {1.0: "after motion +", -1.0: "after motion −", 0.0: "not moved"}


def title(curve: EffectCurve) -> str:
    """Return what is drawn over what."""
    said = f"{_format_effect_at_joints(curve.id, [curve.joint])} over {quantity(curve)}"
    return said[0].upper() + said[1:]


def format_effect_name(effect: AtJoints) -> str:
    """Return what an effect is called, with its joints."""
    return _format_effect_at_joints(effect.id, effect.joints or [])


def across(curve: EffectCurve) -> str:
    """Return the title of the axis along x."""
    return f"{quantity(curve)}, {unit_of_x(curve)}"


def upwards(curve: EffectCurve) -> str:
    """Return the title of the axis along y."""
    return f"what joint {curve.joint} {'rotates' if curve.unit == 'deg' else 'moves'} by, {curve.unit}"


def quantity(curve: EffectCurve) -> str:
    """Return the quantity that the effect follows."""
    rotary = curve.unit == "deg"
    return {
        "q": f"{'angle' if rotary else 'position'} of joint {curve.joint}",
        "axial": f"load {'moment about' if rotary else 'force along'} joint {curve.joint}",
        "t": "time since the first visit",
        "temperature_c": "temperature",
    }.get(curve.follows, curve.follows)


def unit_of_x(curve: EffectCurve) -> str:
    """Return the unit of that quantity as people write it."""
    return "°C" if curve.x_unit == "degC" else curve.x_unit


def model(direction: float | None) -> str:
    """Return what a curve of the model is called in a legend."""
    return f"model{_direction_suffix(direction)}, 95 % band"


def visit(direction: float | None) -> str:
    """Return what the visits of a direction are called in a legend."""
    return f"visit{_direction_suffix(direction)}, 95 % interval"


def _format_effect_at_joints(effect: str, joints: Sequence[int]) -> str:
    *others, last = [str(joint) for joint in joints] or [""]
    where = f" of joints {', '.join(others)} and {last}" if others else f" of joint {last}" if last else ""
    return f"{effect.replace('_', ' ')}{where}"


def _direction_suffix(direction: float | None) -> str:
    return "" if direction is None else f", {SIDES[direction]}"
