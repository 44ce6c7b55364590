"""Where a version corrects: shares of the poses all over the joint limits, and a map of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kilter_service.ground.correction_outcome import REACHED_M
from kilter_service.ground.db import Database
from kilter_service.ground.wire import joint_scale, to_mm
from kilter_service.page.figures.plot import BLUE, GREY, ORANGE, RED, Plot
from kilter_service.page.figures.scale import around
from kilter_service.page.versions.looking_ahead import REFUSED
from kilter_service.page.words import bare, largest, percent, unit
from kilter_service.versions.predictions.workspace import workspace

if TYPE_CHECKING:
    from kilter_core.types import Floats

WHAT = {
    "OK": "corrected to within what is stated",
    "DAMPED": "damped: a singularity is near, or the place is out of reach",
    "LIMITED": "held at a limit of the correction",
    "UNSURE": "corrected, but the version is unsure there",
}
LABELS = {"OK": "corrected", "DAMPED": "damped", "LIMITED": "held at a limit", "UNSURE": "unsure"}
# Drawn in this order, so that the rare ones lie above.
LOOKS = {"OK": (0, GREY), "UNSURE": (0, GREY), "LIMITED": (1, ORANGE), "DAMPED": (0, BLUE)}
REFUSED_LOOK = (2, RED)


@dataclass(frozen=True)
class Shown:
    """Rows of the table (what, share, how many, most that is left), and the map."""

    poses: int
    unit: str
    rows: Sequence[tuple[str, str, int, str]]
    map: Plot


def reach_shown(database: Database, version_id: str, temperature_c: float | None) -> Shown:
    """Look at what a version does all over the joint limits.

    Raises:
        ServiceError: no such version.

    """
    seen = workspace(database, version_id, temperature_c)
    found, words = seen.found, np.array(seen.found.words)
    order = sorted(found.counts, key=_order)
    left = [_most(found.left[words == word]) for word in order]
    most = largest([*left, to_mm(REACHED_M)])
    rows = [
        (
            _state_words(word),
            percent(float((words == word).mean())),
            int((words == word).sum()),
            _format_left_error(one, most),
        )
        for word, one in zip(order, left, strict=True)
    ]
    out = to_mm(np.hypot(seen.points[:, 0], seen.points[:, 1]))
    up = to_mm(seen.points[:, 2])
    plot = Plot(
        "Where the version corrects", around("distance from the axis of the base, mm", out.tolist(), zero=True),
        around("height above the base, mm", up.tolist()), width=560.0, height=380.0,
        description="Each point is a pose drawn within the joint limits, at the place of its tool.",
        table=(["What", "Share", "Poses", f"Most that is left, {unit(most)}"], [[a, b, str(c), d] for a, b, c, d in rows]),
    )  # fmt: skip
    scale = np.array(joint_scale(seen.robot))
    for word in sorted(found.counts, key=_drawn):
        mine = np.flatnonzero(words == word)
        number, colour = LOOKS.get(word, REFUSED_LOOK)
        names = [f"{_label(word)}: {', '.join(f'{v:.0f}' for v in found.q[k] * scale)}" for k in mine]
        plot.points(out[mine].tolist(), up[mine].tolist(), _label(word), number, colour, names)
    return Shown(len(words), unit(most), rows, plot)


def _most(left: Floats) -> float | None:
    """The most that is left, mm; None where it is not known."""
    return None if np.isnan(left).all() else to_mm(float(np.nanmax(left)))


def _format_left_error(left: float | None, most: float | None) -> str:
    """Write it in the unit of the most; to less than a micrometre nothing is computed."""
    least = to_mm(REACHED_M)
    return bare(left, most) if left is None or left >= least else f"below {bare(least, most)}"


def _order(word: str) -> tuple[int, str]:
    return (list(WHAT).index(word) if word in WHAT else len(WHAT), word)


def _drawn(word: str) -> tuple[int, str]:
    return (list(LOOKS).index(word) if word in LOOKS else len(LOOKS), word)


def _state_words(word: str) -> str:
    return WHAT.get(word) or f"refused: {REFUSED.get(word, word.lower().replace('_', ' '))}"


def _label(word: str) -> str:
    return LABELS.get(word) or f"refused ({word.lower().replace('_', ' ')})"
