"""The plots of a report: told apart in black and white by shade, dash and mark."""

from __future__ import annotations

from collections.abc import Sequence

from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.page import words
from kilter_service.page.figures.plot import Plot, Table
from kilter_service.page.figures.scale import category_axis, lengths

INK, HEIGHT = "#141414", 230.0
SHADES = ("#c8c8c8", "#828282", INK)
OF_MODELS = ("#dedede", "#adadad", "#6e6e6e", INK)
STAGES = (
    ("nominal", "nominal robot"),
    ("registration_only", "base and tool fitted only"),
    ("geometry_fitted", "geometry alone, without effects"),
    ("identified", "calibrated"),
)
PLACE = "nominal robot, mostly where instrument, base and tool are: not an error of the arm"
CURVES = {"before, nominal": STAGES[0][1], "registration only": STAGES[1][1], "identified": STAGES[-1][1]}
SIZES = (("mean_mm", "mean"), ("rms_mm", "rms"), ("p95_mm", "95 %"), ("max_mm", "largest"))


def before_and_after(errors: StageErrors, title: str) -> Plot | None:
    """Bars of the errors of each model on the same rows."""
    shown = STAGES if errors.place_mm is None else STAGES[1:]
    found = [(label, getattr(errors, name)) for name, label in shown if getattr(errors, name) is not None]
    if not found:
        return None
    values = [getattr(one, size) for _, one in found for size, _ in SIZES if getattr(one, size) is not None]
    if not values or min(values) <= 0:
        return None
    axis = lengths("error on a logarithmic scale", values, log=True)
    plot = Plot(
        title, category_axis("", [label for _, label in SIZES]), axis, width=620, height=HEIGHT, description=title
    )
    width = 0.8 / len(found)
    shades = OF_MODELS[-len(found) :]
    for k, (label, one) in enumerate(found):
        sizes = [getattr(one, size) for size, _ in SIZES]
        there = [(place, value) for place, value in enumerate(sizes) if value is not None]
        places = [place + 0.1 + (k + 0.5) * width for place, _ in there]
        plot.bars(places, [value for _, value in there], width * 0.92, label, colour=shades[k])
    plot.table = table("Model", found)
    return plot


def table(what: str, judged: Sequence[tuple[str, Errors]]) -> Table:
    """Return the errors of each line below heads that name their unit, that of the largest of them."""
    unit, lengths = words.in_columns([[getattr(one, size) for size, _ in SIZES] for _, one in judged])
    rows = [[label, *sizes] for (label, _), sizes in zip(judged, lengths, strict=True)]
    return [what, *(f"{label}, {unit}" for _, label in SIZES)], rows
