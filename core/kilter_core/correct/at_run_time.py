"""What the effects of a model do at run time, which of them the correction leaves out, and what it would have to know."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from kilter_core.arm.run_time import Conditions, RunTimeForm
from kilter_core.model import RobotModel
from kilter_core.types import Floats

# Conditions that rows may state, with values that are tried; each as the names of its quantities.
_STATED = (
    (("temperature_c",), {"temperature_c": 20.0}),
    (("base_tilt_x", "base_tilt_y"), {"base_tilt": (0.0, 0.0)}),
)


@dataclass(frozen=True)
class AtRunTime:
    """The effects as the correction has them: ids of those ``supported``, names of the ``unsupported`` others.

    ``loaded``: one of them needs loads. ``where_stated`` are the unsupported ones that are made up for where rows state
    more, by name with the quantities that they must state.
    """

    form: RunTimeForm
    supported: tuple[str, ...]
    unsupported: tuple[str, ...]
    loaded: bool
    where_stated: Mapping[str, tuple[str, ...]]


def at_run_time(model: RobotModel, values: Floats, conditions: Conditions) -> AtRunTime:
    """What the effects of a model with these ``values (P,)`` do under these conditions."""
    form = RunTimeForm.empty(model.load_robot, conditions)
    supported: list[str] = []
    unsupported: list[str] = []
    where_stated: dict[str, tuple[str, ...]] = {}
    loaded = False
    for k, (key, where) in enumerate(model.effect_slices().items()):
        effect = model.effects[k]
        if effect.at_run_time(form, values[where]):
            supported.append(effect.id)
            loaded |= "moments" in effect.needs
            continue
        unsupported.append(key)
        asked = _required_quantities(model, k, values[where], conditions)
        if asked:
            where_stated[key] = asked
    return AtRunTime(form, tuple(dict.fromkeys(supported)), tuple(unsupported), loaded, where_stated)


def _required_quantities(model: RobotModel, which: int, values: Floats, conditions: Conditions) -> tuple[str, ...]:
    """Quantities that must be stated for an effect to be made up for; empty: no statement helps."""
    effect = model.effects[which]
    for quantities, tried in _STATED:
        if effect.needs.issuperset(quantities):
            form = RunTimeForm.empty(model.load_robot, replace(conditions, **tried))
            if effect.at_run_time(form, values):
                return quantities
    return ()
