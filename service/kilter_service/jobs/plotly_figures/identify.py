"""The figures of an identification as Plotly documents: errors, residual arrows, worst rows, parameters, workspace."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.observations import evenly
from kilter_service.ground.core import core_identify
from kilter_service.ground.wire import to_mm
from kilter_service.jobs.plotly_figures.layout import (
    BLUE,
    FRAME_PX,
    GREY,
    LEGEND,
    ORANGE,
    RED,
    ROW_PX,
    Document,
    arrows,
    bar_layout,
    distinct_labels,
    layout,
    plain_text,
    round_values,
    shorten_label,
    three_digits,
)

if TYPE_CHECKING:
    from kilter_core.identify import Identification, RowErrors
    from kilter_core.observations import Observations
    from kilter_service.jobs.kind import JobInput

WORST = 20
HELD_OUT, FITTED, SET_ASIDE = "held out", "fitted", "fitted, but counts less than half"
USES = ((HELD_OUT, ORANGE), (FITTED, BLUE), (SET_ASIDE, RED))

FRAMES = ("base_", "tool_")
LEARNED = "residual_"  # weights of a learned function: no physics, and hundreds of them
MOST_PARAMETERS = 60
QUANTILE = 1.96
GAP_ROWS = 3.5  # height between two panels, in bars
KINDS = (("seen by these poses", BLUE), ("outside its physical range", RED), ("not seen by these poses", GREY))
ParameterRow = Mapping[str, Any]


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
                "type": "bar",
                "orientation": "h",
                "name": use,
                "showlegend": True,
                "y": list(labels),
                "marker": {"color": colour},
                "x": [None if row is None else round(row.size, 5) for row in own],
                "hovertext": ["" if row is None else "dx {:.4g} dy {:.4g} dz {:.4g} mm".format(*row.mm) for row in own],
            }


STAGES = (
    ("nominal", "before, nominal", GREY),
    ("registration_only", "registration only", ORANGE),
    ("identified", "identified", BLUE),
)
PER_DECADE, MOST_BINS = 8, 60
SMALLEST_MM = 1e-6
MOST_MEASURED, FEW_MEASURED = 300, 50


def identify_figures(found: Identification, report: Mapping[str, Any], job: JobInput) -> dict[str, Document]:
    """Draw an identification; ``report`` is its result, with the rows set aside by campaign."""
    drawn = {}
    errors, kind = (found.held_rows, "held-out") if found.held_rows else (found.fitted_rows, "fitted")
    if errors is not None and any(len(size) for size in errors.sizes.values()):
        drawn["held_out_errors" if found.held_rows else "fitted_errors"] = _histogram(errors, kind)
        drawn |= arrows(errors, kind)
    drawn |= worst_rows(found, job, report["set_aside"])
    if (bars := changes(report["parameters"])) is not None:
        drawn["parameter_changes"] = bars
    return drawn


def uncertainty_figure(found: Identification, rows: Observations, seed: int) -> dict[str, Document]:
    """Draw the uncertainty of the fit at poses within the limits, from the side and from above."""
    space = core_identify.Workspace.from_calibration(found.calibration, found.predictive, rows, seed).worst_last()
    some = evenly(len(space.measured), MOST_MEASURED)
    low, high = to_mm(float(space.u95.min())), to_mm(float(space.u95.max()))
    data: list[Document] = []
    for n, (i, j) in enumerate(((0, 2), (0, 1))):
        axes = {} if n == 0 else {"xaxis": "x2", "yaxis": "y2"}
        colour: Document = {
            "color": round_values(to_mm(space.u95), 6),
            "colorscale": "Viridis",
            "cmin": low,
            "cmax": high,
        }
        bar = {"colorbar": {"title": {"text": "± mm"}}} if n == 0 else {}
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "within the limits",
                "showlegend": False,
                **axes,
                "x": round_values(to_mm(space.points[:, i]), 1),
                "y": round_values(to_mm(space.points[:, j]), 1),
                "marker": {"size": 6, **colour, **bar},
            }
        )
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "rows that were fitted",
                "showlegend": n == 0,
                **axes,
                "x": round_values(to_mm(space.measured[some, i]), 1),
                "y": round_values(to_mm(space.measured[some, j]), 1),
                "marker": {"size": 4 if len(some) > FEW_MEASURED else 9, "color": RED, "symbol": "x"},
            }
        )
    title = f"Where the tool is known to, 95 %: ±{three_digits(low)} to ±{three_digits(high)} mm per coordinate"
    return {"predicted_error": {"data": data, "layout": _two_views(title)}}


def _two_views(title: str) -> Document:
    def axis(words: str, **more: Any) -> Document:
        return {"title": {"text": words}, **more}

    return {
        "title": {"text": title},
        "width": 1000,
        "height": 560,
        "margin": {"t": 90},
        "legend": LEGEND,
        "xaxis": axis("x of the base, mm", domain=[0.0, 0.45]),
        "yaxis": axis("z of the base, mm", scaleanchor="x", scaleratio=1),
        "xaxis2": axis("x of the base, mm", domain=[0.55, 1.0], anchor="y2"),
        "yaxis2": axis("y of the base, mm", anchor="x2", scaleanchor="x2", scaleratio=1),
    }


def _histogram(errors: RowErrors, kind: str) -> Document:
    """Counts in bins of equal ratio: before and after may be a thousandfold apart."""
    sizes = {name: np.maximum(to_mm(size), SMALLEST_MM) for name, size in errors.sizes.items()}
    every = np.concatenate(list(sizes.values()))
    low, high = np.log10(every.min()) - 0.05, np.log10(every.max()) + 0.05
    edges = np.logspace(low, high, int(np.clip((high - low) * PER_DECADE, 5, MOST_BINS)) + 1)
    data = []
    for name, label, colour in STAGES:
        counts = np.histogram(sizes[name], edges)[0]
        rms, median = np.sqrt(np.mean(sizes[name] ** 2)), np.median(sizes[name])
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": round_values(edges, 7),
                "name": f"{label}: median {three_digits(median)}, rms {three_digits(rms)} mm",
                "y": [*counts.tolist(), 0],
                "line": {"color": colour, "shape": "hv"},
                "fill": "tozeroy",
            }
        )
    number = len(sizes["identified"])
    made = layout(f"Errors of {number} {kind} rows", "error, mm (each division ten times the one before)", "rows")
    made["xaxis"] |= {"type": "log"}
    return {"data": data, "layout": made}


def changes(parameters: Sequence[ParameterRow]) -> Document | None:
    """Draw the changes of parameters; base and tool say where the instrument is: they are drawn only alone."""
    rows = [p for p in parameters if p["value"] is not None and not str(p["name"]).startswith(LEARNED)]
    own = [p for p in rows if not str(p["name"]).startswith(FRAMES)]
    rows = own or rows
    if not rows:
        return None
    drawn = _most_telling(rows)
    units = list(dict.fromkeys(str(p["unit"]) for p in drawn))
    panels = [[p for p in drawn if p["unit"] == unit] for unit in units]
    number = f"{len(drawn)} of {len(rows)}" if len(drawn) < len(rows) else str(len(rows))
    made = _layout(f"What the identification changed: {number} parameters, 95 % intervals", units, panels)
    return {
        "data": [trace for n, panel in enumerate(panels) for trace in _parameter_bars(panel, n, drawn)],
        "layout": made,
    }


def _most_telling(rows: Sequence[ParameterRow]) -> list[ParameterRow]:
    """The parameters that are surest to have changed, in their own order."""
    ranked = sorted(rows, key=lambda p: (not p["identifiable"], -abs(_change(p)) / (p["sigma"] or 1e-30)))
    kept = {id(p) for p in ranked[:MOST_PARAMETERS]}
    return [p for p in rows if id(p) in kept]


def _change(p: ParameterRow) -> float:
    return float(p["value"]) - float(p["nominal"])


def _kind(p: ParameterRow) -> str:
    if not p["identifiable"]:
        return KINDS[2][0]
    return KINDS[0][0] if p["plausible"] else KINDS[1][0]


def _interval(p: ParameterRow) -> tuple[float, float]:
    """How far (below, above) the change the interval goes; nothing where the poses say nothing."""
    if not p["identifiable"] or p["sigma"] is None:
        return 0.0, 0.0
    if p.get("lower") is not None:
        return float(p["value"] - p["lower"]), float(p["upper"] - p["value"])
    return QUANTILE * p["sigma"], QUANTILE * p["sigma"]


def _parameter_bars(panel: Sequence[ParameterRow], n: int, drawn: Sequence[ParameterRow]) -> list[Document]:
    """One trace for each kind that is in the panel, over all its names so that their order stays."""
    axes = {} if n == 0 else {"xaxis": f"x{n + 1}", "yaxis": f"y{n + 1}"}
    names = distinct_labels([str(p["name"]) for p in panel])
    out = []
    for kind, colour in KINDS:
        own = [_kind(p) == kind for p in panel]
        if not any(own):
            continue
        ends = [_interval(p) for p in panel]
        first = next(p for p in drawn if _kind(p) == kind)
        out.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": kind,
                "legendgroup": kind,
                "showlegend": first in panel,
                **axes,
                "y": names,
                "x": [_digits(_change(p)) if mine else None for p, mine in zip(panel, own, strict=True)],
                "marker": {"color": colour},
                "error_x": {
                    "type": "data",
                    "symmetric": False,
                    "thickness": 1.2,
                    "color": "#202124",
                    "array": [_digits(above) if mine else None for (_, above), mine in zip(ends, own, strict=True)],
                    "arrayminus": [
                        _digits(below) if mine else None for (below, _), mine in zip(ends, own, strict=True)
                    ],
                },
            }
        )
    return out


def _digits(value: float) -> float:
    return float(f"{value:.5g}")


def _layout(title: str, units: Sequence[str], panels: Sequence[Sequence[ParameterRow]]) -> Document:
    """Panels one below the other, as high as they have bars."""
    heights = [float(len(panel)) for panel in panels]
    whole = sum(heights) + GAP_ROWS * (len(panels) - 1)
    made: Document = {
        "title": {"text": title},
        "barmode": "overlay",
        "height": round(FRAME_PX + ROW_PX * max(4.0, whole)),
        "margin": {"t": 110},
        "legend": {"orientation": "h", "yanchor": "bottom", "y": 1.0},
    }
    top = 1.0
    for n, (unit, height) in enumerate(zip(units, heights, strict=True)):
        own, low = "" if n == 0 else str(n + 1), max(0.0, top - height / whole)
        made[f"xaxis{own}"] = {
            "title": {"text": f"change, {unit}" if unit else "change"},
            "anchor": f"y{own}",
            "zeroline": True,
        }
        made[f"yaxis{own}"] = {
            "title": {"text": ""},
            "domain": [low, top],
            "anchor": f"x{own}",
            "automargin": True,
            "type": "category",
            "autorange": "reversed",
        }
        top = low - GAP_ROWS / whole
    return made
