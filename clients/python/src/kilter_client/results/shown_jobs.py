"""How the results of jobs, versions and campaigns look."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

from kilter_client.results.record import decimals, ends, estimate
from kilter_client.results.rows import Rows, html_table, number
from kilter_client.results.shown import Asking, Shown


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
