"""Which effects a search was asked to look for, and at which joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_core.effects import EFFECTS
from kilter_core.errors import OptionError

Asked = str | Mapping[str, Any]


def joints_by_effect(only: Sequence[Asked]) -> dict[str, frozenset[int] | None]:
    """Ids with the joints (from 0) to look at, None for all; of an effect named twice the joints of both.

    Raises:
        OptionError: an effect that does not exist or is not searched for, or an option that a search chooses itself.

    """
    out: dict[str, frozenset[int] | None] = {}
    for one in only:
        effect_id, joints = _read({"id": one} if isinstance(one, str) else one)
        before = out.get(effect_id, frozenset())
        out[effect_id] = None if joints is None or before is None else before | joints
    return out


def _read(one: Mapping[str, Any]) -> tuple[str, frozenset[int] | None]:
    effect_id = str(one.get("id"))
    kind = EFFECTS.get(effect_id)
    if kind is None:
        raise OptionError(f"There is no effect {effect_id!r}. There are: {', '.join(EFFECTS)}.", option="effects")
    if kind.nuisance:
        raise OptionError(f"{effect_id} is carried by every search, not searched: leave it out.", option="effects")
    if kind.learned:
        raise OptionError(f"{effect_id} is learned, not searched: give it to an identification.", option="effects")
    more = sorted(name for name, value in one.items() if name not in ("id", "joints"))
    if more:
        raise OptionError(
            f"A search chooses {more[0]} of {effect_id} itself: name the effect and its joints alone.", option="effects"
        )
    joints = one.get("joints")
    if joints is None:
        return effect_id, None
    if not kind.at_joints:
        raise OptionError(f"{effect_id} does not act at joints: leave joints out.", option="effects")
    if not joints or not all(type(j) is int and j >= 1 for j in joints):
        raise OptionError(f"joints of {effect_id} is {joints!r}: give joint numbers from 1, as [2].", option="effects")
    return effect_id, frozenset(j - 1 for j in joints)
