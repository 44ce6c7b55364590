"""How results look as text and in a notebook, with the unit beside each value."""

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
from kilter_client.results.record import decimals, ends, estimate
from kilter_client.results.rows import Rows, Tabular, html_table, number

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


def parameter_table(parameters: Sequence[Any]) -> str:
    """Return the parameters for a notebook: nominal, change and interval, no digits beyond what is known."""
    return html_table(
        ("parameter", "nominal", "value", "change", "95 % interval", "unit", ""),
        [_parameter(one) for one in parameters],
        "parameters",
    )


def _parameter(one: Any) -> tuple[str, ...]:
    places = decimals(one.sigma)
    interval = ends(one.value, one.sigma, one.lower, one.upper)
    remark = one.reason or ("not identifiable" if one.identifiable is False else "")
    found = (estimate(one.value, places), estimate(one.change, places))
    return (one.name, number(one.nominal), *found, interval, one.unit or "", remark)


class OfVersion:
    """A version, by the name that the results of jobs have for its id too."""

    id: str

    @property
    def version_id(self) -> str:
        """The id, as the result of the job that made the version calls it."""
        return self.id


class WithParameters(Shown, Asking):
    """What was fitted: errors before and after, and parameters."""

    parameters: Any

    def _tables(self) -> Iterator[str]:
        metrics = getattr(self, "metrics", None)
        if metrics is not None:
            yield metrics._repr_html_()
        yield parameter_table(self.parameters)


class ShownFit(WithParameters):
    """An identification: its version, its errors before and after, its parameters."""

    version_id: str | None

    def _line(self) -> str:
        metrics = getattr(self, "metrics", None)
        errors = "" if metrics is None else f": {metrics!r}"
        headline = getattr(self, "headline", None)
        known = f": {headline}" if headline else f"{errors}; {len(self.parameters)} parameters"
        return f"version {self.version_id}{known}"


class ShownVersion(OfVersion, WithParameters):
    """A version as it is stored."""

    name: str
    robot: str
    active: bool
    metrics: Any

    def _line(self) -> str:
        called = f" {self.name!r}" if self.name else ""
        state = "active" if self.active else "not active"
        return (
            f"version {self.id}{called} of {self.robot}, {state}: {self.metrics!r}; {len(self.parameters)} parameters"
        )


class ShownSearch(Shown, Asking):
    """A gap search: what it names, and how the gap shrank."""

    headline: str | None
    sentence: str | None
    gap: Any
    effects: Any

    def _line(self) -> str:
        return self.headline or "nothing is said"

    @property
    def _by_views(self) -> str:
        """What lengths of the search are, where they are not at the tool."""
        return " by views" if self.gap is not None and self.gap.lengths == "by_views" else ""

    def _tables(self) -> Iterator[str]:
        if self.sentence:
            yield f"<p>{escape(self.sentence)}</p>"
        head = ("effect", "joints", "verdict", f"gain mm{self._by_views}", "moves mm", "p")
        yield html_table(head, [_effect(one) for one in self.effects], "effects")


def _effect(one: Any) -> tuple[str, ...]:
    joints = ", ".join(map(str, one.joints))
    gain = number(one.gain_mm, 3)
    weighed = " (a gain of weighed errors only)" if one.gain_mm is not None and one.gain_mm < 0.0 else ""
    return one.id, joints, str(one.verdict), gain + weighed, number(one.moves_mm, 3), number(one.p_value, 2)


class ShownEvaluation(Shown):
    """How well a version predicts each campaign."""

    metrics: Any
    iso9283: Any
    version_id: str | None

    def _line(self) -> str:
        of = f"version {self.version_id}" if self.version_id else "the nominal robot"
        known = [(one.name or campaign, one.identified or one.nominal) for campaign, one in self.metrics.items()]
        shown = [f"{campaign} mean error {errors.mean_mm:.3g} mm" for campaign, errors in known if errors is not None]
        for campaign, report in self.iso9283.items():
            shown += [f"{campaign} {symbol} {number(found.mm, 3)} mm" for symbol, found in report.metrics.items()]
        return f"{of}: {', '.join(shown) or 'no errors'}"


class ShownDrift(Shown):
    """Whether an arm has moved, or what was changed for it."""

    sentence: str | None

    def _line(self) -> str:
        return getattr(self, "headline", None) or self.sentence or "nothing is said"


class ShownPlan(Shown):
    """Poses to measure."""

    count: int | None
    purpose: str | None
    csv: str | None

    def _line(self) -> str:
        return f"{self.count} poses for {self.purpose}"

    def to_rows(self) -> Rows:
        """Return the poses: joints with their unit, directions, loads."""
        return Rows((self.csv or "").encode())


class ShownCampaign:
    """A campaign."""

    id: str
    name: str
    robot: str
    rows: int
    role: str
    device: str

    def __repr__(self) -> str:
        measured = f" by {self.device}" if self.device else ""
        return f"campaign {self.id} {self.name!r} of {self.robot}: {self.rows} rows, role {self.role}{measured}"


class ShownUpload:
    """What was stored."""

    campaign_id: str
    rows: int
    total_rows: int
    new: bool
    columns: tuple[str, ...]

    def __repr__(self) -> str:
        known = "" if self.new else ", which were there already"
        return (
            f"campaign {self.campaign_id}: {self.rows} rows{known}, {self.total_rows} in all; {', '.join(self.columns)}"
        )


class ShownActivated(Shown):
    """A version that was made active, and what it was compared with."""

    id: str
    robot: str
    forced: bool
    compared: Any
    not_corrected: str

    def _line(self) -> str:
        compared = self.compared
        rival = None if compared is None else compared.active
        before = "" if rival is None else f", {rival.mean_mm:.3g} mm with the version before"
        error = "" if compared is None else f": mean error {compared.mean_mm:.3g} mm on {compared.rows} rows{before}"
        left_out = f". {self.not_corrected}" if self.not_corrected else ""
        return f"version {self.id} corrects {self.robot}{' (forced)' if self.forced else ''}{error}{left_out}"


class ShownDiff(Shown):
    """What differs between two versions."""

    a: str
    b: str
    parameters: Any
    effects_added: tuple[str, ...]
    effects_removed: tuple[str, ...]

    def _line(self) -> str:
        moved = sum(1 for one in self.parameters if one.change)
        effects = [f"+{name}" for name in self.effects_added] + [f"-{name}" for name in self.effects_removed]
        return f"{self.a} to {self.b}: {moved} of {len(self.parameters)} parameters differ {' '.join(effects)}".rstrip()

    def _tables(self) -> Iterator[str]:
        yield self.parameters._repr_html_()
