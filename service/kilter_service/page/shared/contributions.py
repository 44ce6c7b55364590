"""How far each effect of a version moves the tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from kilter_service.ground.db import Database
from kilter_service.page.figures.plot import Plot
from kilter_service.page.figures.scale import category_axis, lengths
from kilter_service.page.words import in_columns
from kilter_service.versions.predictions.at_pose import contributions

if TYPE_CHECKING:
    from kilter_service.versions.predictions.at_pose import Contribution

COLOURS = ("", "")  # those of plots


@dataclass(frozen=True)
class Moved:
    """The effects that move the tool at ``poses`` within the joint limits, the largest first.

    ``elsewhere`` are those that act only with what such poses do not state.
    """

    poses: int
    effects: Sequence[Contribution]
    elsewhere: Sequence[str]

    def plot(self, colours: tuple[str, str] = COLOURS, width: float = 640.0) -> Plot:
        """Draw rms and largest movement."""
        names = [one.effect for one in self.effects]
        rms, largest = [one.rms_mm or 0.0 for one in self.effects], [one.largest_mm or 0.0 for one in self.effects]
        unit, rows = in_columns(list(zip(rms, largest, strict=True)))
        drawn = Plot(
            "Movement of the tool by each effect",
            category_axis("", names),
            lengths("movement", [*rms, *largest], zero=True),
            width,
            260.0,
            description="Two bars for each effect: root mean square and largest movement of the tool.",
            table=(
                ["effect", f"rms, {unit}", f"largest, {unit}"],
                [[name, *sizes] for name, sizes in zip(names, rows, strict=True)],
            ),
        )
        drawn.bars([k + 0.32 for k in range(len(names))], rms, 0.3, "root mean square", 0, colours[0])
        drawn.bars([k + 0.68 for k in range(len(names))], largest, 0.3, "largest", 1, colours[1])
        return drawn


def moved_by_each(database: Database, version_id: str) -> Moved:
    """Say how far each effect of a version moves the tool."""
    poses, found = contributions(database, version_id)
    return Moved(
        poses, [one for one in found if one.rms_mm is not None], [one.effect for one in found if one.rms_mm is None]
    )
