"""The rows with the largest errors after an identification, by campaign and number."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_service.ground.wire import to_mm
from kilter_service.jobs.plotly_figures.layout import BLUE, ORANGE, RED, Document, bar_layout, plain_text, shorten_label

if TYPE_CHECKING:
    from kilter_core.identify import Identification
    from kilter_core.identify.fit.row_errors import RowErrors
    from kilter_service.jobs.kind import JobInput

WORST = 20
HELD_OUT, FITTED, SET_ASIDE = "held out", "fitted", "fitted, but counts less than half"
USES = ((HELD_OUT, ORANGE), (FITTED, BLUE), (SET_ASIDE, RED))


@dataclass(frozen=True)
class Row:
    """A row of a campaign, counted from 1, what is left of it in mm, and what it was used for."""

    campaign: str
    number: int
    mm: tuple[float, float, float]
    use: str

    @property
    def size(self) -> float:
        """Length of what is left, mm."""
        return float(np.linalg.norm(self.mm))


def worst_rows(found: Identification, job: JobInput, aside: Sequence[Mapping[str, Any]]) -> dict[str, Document]:
    """Draw the worst rows; ``aside`` are those that a robust loss set aside. Nothing where rows measure no point."""
    worst = sorted(_candidates(found, job, aside), key=lambda row: -row.size)[:WORST]
    if not worst:
        return {}
    names = _names(job)
    labels = [plain_text(f"{names[row.campaign]} row {row.number}") for row in worst]
    made = bar_layout(
        f"The {len(worst)} rows with the largest errors", "error of the identified model, mm", labels, barmode="overlay"
    )
    return {"worst_rows": {"data": list(_bars(worst, labels)), "layout": made}}


def _candidates(found: Identification, job: JobInput, aside: Sequence[Mapping[str, Any]]) -> Iterator[Row]:
    """The worst of each use. Folds hold every fitted row out once: then it is that error which counts."""
    rows = {name: len(part) for name, part in job.campaigns.items()}
    own = isinstance(job.validation, dict)
    held = {name: len(part) for name, part in job.validation.items()} if isinstance(job.validation, dict) else rows
    folds = found.held_rows is not None and not own and found.inside is None
    yield from _iter_worst_rows(found.held_rows, held, HELD_OUT, frozenset())
    if not folds:
        let_go = frozenset((str(one["campaign"]), int(one["row"])) for one in aside)
        yield from _iter_worst_rows(found.fitted_rows, rows, FITTED, let_go)


def _iter_worst_rows(
    errors: RowErrors | None, campaigns: Mapping[str, int], use: str, let_go: frozenset[tuple[str, int]]
) -> Iterator[Row]:
    if errors is None or errors.rows is None:
        return
    left = to_mm(errors.left["identified"])
    size = np.linalg.norm(left, axis=1)
    for k in np.argsort(-size, kind="stable")[:WORST]:
        if np.isfinite(size[k]):
            campaign, number = _campaign_and_row(int(errors.rows[k]), campaigns)
            x, y, z = (float(v) for v in left[k])
            yield Row(campaign, number, (x, y, z), SET_ASIDE if (campaign, number) in let_go else use)


def _campaign_and_row(row: int, campaigns: Mapping[str, int]) -> tuple[str, int]:
    """Campaign of a row (from 0) of several campaigns one after another, and its number there, from 1."""
    for campaign, count in campaigns.items():
        if row < count:
            return campaign, row + 1
        row -= count
    raise IndexError(row)


def _names(job: JobInput) -> dict[str, str]:
    """Campaigns by their names, by their ids where two names look the same."""
    every = [*job.campaigns, *(job.validation if isinstance(job.validation, dict) else ())]
    names = {campaign: shorten_label(job.names.get(campaign) or campaign) for campaign in every}
    count = Counter(names.values())
    return {campaign: name if count[name] == 1 else campaign for campaign, name in names.items()}


def _bars(worst: Sequence[Row], labels: Sequence[str]) -> Iterator[Document]:
    """One trace for each use, over all labels so that the order stays."""
    for use, colour in USES:
        own = [row if row.use == use else None for row in worst]
        if any(own):
            yield {
                "type": "bar", "orientation": "h", "name": use, "showlegend": True, "y": list(labels),
                "marker": {"color": colour},
                "x": [None if row is None else round(row.size, 5) for row in own],
                "hovertext": ["" if row is None else "dx {:.4g} dy {:.4g} dz {:.4g} mm".format(*row.mm) for row in own],
            }  # fmt: skip
