"""How results look as text and in a notebook; values have their unit beside them, whatever people named is escaped."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

from kilter_client.errors import MissingPackageError, UsageError
from kilter_client.requests.calls import versions
from kilter_client.results.plots import draw
from kilter_client.results.rows import Rows, Tabular

if TYPE_CHECKING:
    from kilter_client.results.record import Record


MODELS = {
    "nominal": "nominal",
    "registration_only": "registration only",
    "geometry_fitted": "geometry alone",
    "without_effects": "without its effects",
    "identified": "identified",
}
PLACED = "nominal, mostly where instrument, base and tool are"
MOSTLY = 0.5  # more than half of a number is what it mostly is
ROWS = {"train": "fitted", "validation": "held out"}
ERRORS = ("mean_mm", "rms_mm", "p95_mm", "max_mm", "orientation_deg")


def nominal_words(nominal_mm: float | None, registration_mm: float | None) -> str:
    """Name the error of the nominal robot, as the page does.

    Where base and tool alone take most of it away, it says where the instrument stands, and is not an error of the arm.
    """
    if nominal_mm is None or registration_mm is None:
        return MODELS["nominal"]
    return PLACED if nominal_mm - registration_mm > MOSTLY * nominal_mm else MODELS["nominal"]


def _words(stage: Any, model: str) -> str:
    if model != "nominal" or stage.nominal is None or stage.registration_only is None:
        return MODELS[model]
    return nominal_words(stage.nominal.mean_mm, stage.registration_only.mean_mm)


class ShownParameter:
    """A parameter; ``change`` is its value minus nominal, in its unit, None where one of them is missing."""

    nominal: float | None
    value: float | None
    change: float | None

    def __post_init__(self) -> None:
        """Find the change where the answer does not say it."""
        told = getattr(self, "change", None)
        if told is None and self.value is not None and self.nominal is not None:
            told = self.value - self.nominal
        object.__setattr__(self, "change", told)


class ShownMetrics(Tabular):
    """Errors before, with registration only and after, as a table."""

    train: Any
    validation: Any

    def to_dict(self) -> dict[str, list[Any]]:
        """Return a row for each model on each set of rows, in mm and degrees."""
        found = [*self._errors()]
        columns: dict[str, list[Any]] = {
            "rows": [rows for rows, _, _, _ in found],
            "model": [model for _, model, _, _ in found],
            "points": [points for _, _, points, _ in found],
        }
        return columns | {name: [getattr(errors, name) for *_, errors in found] for name in ERRORS}

    def _errors(self) -> Iterator[tuple[str, str, int | None, Any]]:
        for rows, called in ROWS.items():
            stage = getattr(self, rows)
            for model in MODELS if stage is not None else ():
                errors = getattr(stage, model)
                if errors is not None:
                    yield called, _words(stage, model), stage.n, errors

    def __repr__(self) -> str:
        stage = self.validation or self.train
        if stage is None:
            return "no errors of the tool: none was measured"
        called = "held-out" if self.validation is not None else "fitted"
        known = [(_words(stage, model), getattr(stage, model)) for model in MODELS]
        shown = [f"{errors.mean_mm:.3g} mm {words}" for words, errors in known if errors is not None]
        return f"mean error of {stage.n} {called} points: {', '.join(shown)}"


class Asking:
    """A result of which the server knows more."""

    def residuals(self, campaigns: Sequence[str] = ()) -> Rows:
        """Return the residuals of every row, in mm: of these campaigns, or of all its own.

        Raises:
            UsageError: it made no version, or came from an ``AsyncKilter``: ``await k.residuals(result)``.

        """
        record = cast("Record", self)
        version = record.get("version_id") or record.get("id")
        if not version:
            raise UsageError("This result made no version, so it leaves no residuals.")
        call = versions.residuals(str(version), campaigns, "csv", None)
        return Rows(record._ask_server(call, "await k.residuals(result)"))


class ShownFigure:
    """A figure as Plotly describes it; drawn by matplotlib where that is installed."""

    document: Mapping[str, Any]

    def save(self, path: Path | str) -> Path:
        """Draw the figure to a file that ends in .png or .svg.

        Raises:
            MissingPackageError: matplotlib is not installed.

        """
        file = Path(path)
        (done,) = draw(self.document, file.with_suffix(""), (file.suffix.lower().removeprefix("."),))
        return done

    def _repr_png_(self) -> bytes | None:
        with TemporaryDirectory() as folder:
            try:
                return self.save(Path(folder) / "figure.png").read_bytes()
            except MissingPackageError:
                return None

    def __repr__(self) -> str:
        title = (self.document.get("layout") or {}).get("title") or {}
        return f"Figure: {str(title.get('text', '')).partition('<')[0]}"


class Shown:
    """A result with warnings and perhaps figures: one or two lines as text, tables and its first figure in a notebook."""

    warnings: Any

    @property
    def job(self) -> Record | None:
        """The job that found it, with its campaigns and options; None where it is not an answer of a job."""
        return getattr(self, "_job", None)

    def _line(self) -> str:
        return type(self).__name__

    def _tables(self) -> Iterator[str]:
        yield from ()

    def __repr__(self) -> str:
        warned = len(getattr(self, "warnings", None) or ())
        return self._line() + (f"; {warned} warnings" if warned > 1 else "; 1 warning" if warned else "")

    def _repr_html_(self) -> str:
        parts = [f"<p>{escape(self._line())}</p>", *self._tables()]
        parts += [f"<p>Warning: {escape(str(one.message))}</p>" for one in getattr(self, "warnings", None) or ()]
        picture = self._repr_png_()
        if picture:
            parts.append(f'<img alt="" src="data:image/png;base64,{b64encode(picture).decode()}">')
        return "".join(parts)

    def _repr_png_(self) -> bytes | None:
        figures: Mapping[str, ShownFigure] = getattr(self, "figures", None) or {}
        first = next(iter(figures.values()), None)
        return None if first is None else first._repr_png_()
