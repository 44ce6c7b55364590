"""What a report says of effects: what each is, how far it moves the tool, and how a search closed the gap with them."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.versions import Version
from kilter_service.ground.core import core_effects
from kilter_service.ground.db import Database
from kilter_service.page import words
from kilter_service.page.figures.plot import Plot
from kilter_service.page.report.figures import SHADES
from kilter_service.page.shared import contributions, steps


@dataclass(frozen=True)
class Effect:
    """What an effect is, and how far it moves the tool: at poses, and on the rows that were searched."""

    name: str
    joints: str
    what: str
    rms: str
    largest: str
    searched: str


@dataclass(frozen=True)
class Contributions:
    """The effects of a version in one ``unit``, and how far each moves the tool at ``poses`` within the joint limits."""

    poses: int
    unit: str
    effects: list[Effect]
    plot: Plot | None


def effect_contributions(database: Database, version: Version, search: GapResult | None) -> Contributions:
    """Say of each effect what it is and what it does; uncertain masses move nothing by themselves."""
    own = [one for one in version.effects if one != words.MASSES]
    named = {one.id: one for one in (search.effects if search is not None else None) or []}
    moved = contributions.moved_by_each(database, version.id)
    sizes = {one.effect: [one.rms_mm, one.largest_mm] for one in moved.effects}
    searched = [named[one].moves_mm if one in named else None for one in own]
    lengths = [[*sizes.get(effect, [None, None]), here] for effect, here in zip(own, searched, strict=True)]
    shown = []
    unit, columns = words.in_columns(lengths)
    for effect, (rms, largest, here) in zip(own, columns, strict=True):
        found = named.get(effect)
        joints = words.of_joints(found.joints) if found is not None and found.joints else ""
        kind = core_effects.EFFECTS.get(effect)
        what = kind.summary if kind is not None else ""
        shown.append(Effect(effect, joints, what, rms, largest, here))
    return Contributions(moved.poses, unit, shown, moved.plot(SHADES[1:], 620.0) if moved.effects else None)


def closing(search: GapResult | None) -> tuple[Plot, str] | None:
    """How a search closed the gap, step by step: drawn, and in a sentence."""
    read = None if search is None else steps.steps_shown(search.figures, steps.error_unit(search.gap))
    return None if read is None else (steps.plot(read, SHADES[:2]), steps.describe(read))
