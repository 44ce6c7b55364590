"""Errors of several models on the same rows: bars, with the numbers beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.page.figures.plot import Plot
from kilter_service.page.figures.scale import category_axis, lengths
from kilter_service.page.words import in_columns, in_one_unit

STAGES = (
    ("nominal", "Before"),
    ("registration_only", "Registration only"),
    ("geometry_fitted", "Geometry alone"),
    ("without_effects", "Without its effects"),
    ("identified", "After"),
)
BARS = (("mean_mm", "mean", -0.27), ("rms_mm", "rms", 0.0), ("p95_mm", "95 % are below", 0.27))
CURVES = {"before, nominal": "Before", "registration only": "Registration only", "identified": "After"}
PLACED = "Nominal, mostly where instrument, base and tool are"
ALONE = {"Geometry alone", "Without its effects"}
EARLIER = "Geometry only"  # either of them, as an earlier release stored it
NO_OTHER: Mapping[str, str] = {}
MEANING = {
    "Before": "the nominal robot, where it is said to stand",
    PLACED: "no version takes this away, and it is not an error of the arm",
    "Registration only": "the nominal robot, base and tool fitted to the rows: what comes from the set-up alone is gone",
    "Geometry alone": "the geometry fitted to the same rows without effects: the best rigid arm",
    "Without its effects": "its geometry as it is, what bends and gives left out, as in a file of geometry alone",
    EARLIER: "the geometry without effects",
    "After": "the model that was identified",
}


def compared_models(errors: StageErrors | None, other: Mapping[str, str] = NO_OTHER) -> list[tuple[str, Errors]]:
    """Return the models that were compared, in the order of what they know; ``other`` renames some."""
    placed = errors is not None and errors.place_mm is not None
    named = [(name, PLACED if placed and name == "nominal" else other.get(title, title)) for name, title in STAGES]
    found = [(title, getattr(errors, name, None)) for name, title in named]
    if not {title for title, one in found if one is not None} & ALONE:
        found.insert(-1, (EARLIER, getattr(errors, "geometry_only", None)))
    return [(title, one) for title, one in found if one is not None]


def bars(errors: StageErrors | None, where: str, other: Mapping[str, str] = NO_OTHER) -> Plot | None:
    """Draw a bar for each model; None: nothing was measured."""
    stages = [
        one for one in compared_models(errors, other) if one[0] != PLACED
    ]  # beside it all others would be as good as zero
    if not stages:
        return None
    shown = [getattr(one, name) or 0.0 for _, one in stages for name, _, _ in BARS]
    plot = Plot(
        f"Errors of the tool on {where}",
        category_axis("", [title for title, _ in stages]),
        lengths("error", shown, zero=True),
        description=_means(stages),
        table=table(errors, other),
    )
    for number, (name, label, shift) in enumerate(BARS):
        values = [getattr(one, name) for _, one in stages]
        places = [k + 0.5 + shift for k, value in enumerate(values) if value is not None]
        plot.bars(places, [value for value in values if value is not None], 0.25, label, number)
    return plot


def _means(stages: Sequence[tuple[str, Errors]]) -> str:
    sizes = in_one_unit([[one.mean_mm] for _, one in stages])
    return "; ".join(f"{title}: mean {mean}" for (title, _), (mean,) in zip(stages, sizes, strict=True))


def table(errors: StageErrors | None, other: Mapping[str, str] = NO_OTHER) -> tuple[list[str], list[list[str]]]:
    """Return the same numbers in words."""
    found = compared_models(errors, other)
    unit, sizes = in_columns([[one.mean_mm, one.rms_mm, one.p95_mm, one.max_mm] for _, one in found])
    rows = [[title, *row] for (title, _), row in zip(found, sizes, strict=True)]
    return ["Model", *(f"{name}, {unit}" for name in ("Mean", "Rms", "95 % are below", "Largest"))], rows
