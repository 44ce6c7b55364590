"""Which share of the rows has at most which error, from the histogram that an identification leaves."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate

from kilter_service.contract.figures import PlaneFigure, Scatter
from kilter_service.page.figures.plot import Plot
from kilter_service.page.figures.scale import around, lengths
from kilter_service.page.words import in_columns


def cumulative(
    figure: PlaneFigure | None, where: str, names: Mapping[str, str], colour: str = "", height: float = 320.0
) -> Plot | None:
    """Draw a curve for each model, told apart by its dashes, the last one solid; None: there is no histogram.

    ``names`` says what the models of the histogram are called here, ``colour`` is that of all curves (empty: one each).
    """
    traces = [
        (_model_label(one.name or "", names), *_shares(one))
        for one in (figure.data or [] if figure is not None else [])
    ]
    traces = [one for one in traces if one[1]]
    if not traces:
        return None
    unit, errors = in_columns([[_error_at_share(xs, ys, 50.0), xs[-1]] for _, xs, ys in traces])
    plot = Plot(
        f"Share of {where} with at most an error",
        lengths("error", [x for one in traces for x in one[1]], log=True),
        around("share of rows, %", [0.0, 100.0], zero=True),
        height=height,
        description="The further left a curve rises, the smaller the errors.",
        table=(
            ["Model", f"Half of the rows are below, {unit}", f"All are below, {unit}"],
            [[one[0], *row] for one, row in zip(traces, errors, strict=True)],
        ),
    )
    for place, (name, xs, ys) in enumerate(traces):
        plot.line(xs, ys, name, len(traces) - 1 - place, colour)
    return plot


def _model_label(name: str, names: Mapping[str, str]) -> str:
    """What a model is called: the histogram's own name has numbers behind a colon."""
    short = name.partition(":")[0]
    return names.get(short, short)


def _shares(trace: Scatter) -> tuple[list[float], list[float]]:
    """Return errors and the share of rows below each, from counts per bin: each is given with its lower edge."""
    edges = [float(x) for x in trace.x if isinstance(x, int | float)]
    counts = [y or 0.0 for y in trace.y]
    total = sum(counts)
    if not total or len(edges) != len(counts):
        return [], []
    shares = [100.0 * share / total for share in accumulate(counts)]
    first = next(k for k, share in enumerate(shares) if share > 0)
    last = next(k for k, share in enumerate(shares) if share >= 100.0 - 1e-9)
    return edges[first : last + 2], [0.0, *shares[first : last + 1]]


def _error_at_share(xs: list[float], ys: list[float], share: float) -> float:
    return next(x for x, y in zip(xs, ys, strict=True) if y >= share - 1e-9)
