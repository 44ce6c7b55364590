"""How well a calibration predicts measurements it was not fitted to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from kilter_core.errors import FindingDocument
from kilter_core.identify.comparison import Difference, PoseErrors, elsewhere
from kilter_core.identify.estimate import new_frames, refit_frames
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.identify.view_report import left_open, tell_less
from kilter_core.measurement import Measurement, Residual
from kilter_core.measurement.frames import Errors
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import Floats, Ints

CHANCE = 1e-3  # of naming any row where all are as expected
SIGMAS = 1.96  # half width of a 95 % interval
UNLIKE = 7.0  # times the median of all rows, below which a row is like the others
LISTED = 20


def far_off(error: Floats, u95: Floats) -> tuple[Ints, Floats]:
    """Rows of ``error (N, 3)`` m that are far off, from 0, the worst first, and their largest coordinates (K,) in sigmas.

    A row is far off where its largest coordinate is so in the half widths ``u95 (N, 3)`` m of 95 % intervals, by Bonferroni
    over all coordinates, whose correlation does not matter then. It must be unlike the others as well: where an arm has moved,
    all rows miss by more than was expected, and none of them is wrong.
    """
    with np.errstate(invalid="ignore"):
        sigmas = np.max(SIGMAS * np.abs(error) / u95, axis=1)
    seen = np.isfinite(sigmas)
    if not seen.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    chance = -float(ndtri(CHANCE / (2.0 * 3.0 * np.count_nonzero(seen))))
    limit = max(chance, UNLIKE * float(np.median(sigmas[seen])))
    rows = np.flatnonzero(seen & (np.where(seen, sigmas, 0.0) > limit))
    rows = rows[np.argsort(-sigmas[rows], kind="stable")]
    return rows, sigmas[rows]


def warning(error: Floats, u95: Floats | None) -> Iterator[FindingDocument]:
    """Name the rows that are far off; nothing where none is, or nobody knows what was to be expected."""
    rows, sigmas = (np.zeros(0, dtype=np.int64), np.zeros(0)) if u95 is None else far_off(error, u95)
    if not len(rows):
        return
    sizes = np.linalg.norm(error, axis=1)
    off_mm = [mm(one) for one in sizes[rows]]
    others = np.delete(sizes, rows)
    most = mm(float(np.nanmedian(others)))
    named = [f"{row + 1} ({off:.3g} mm, {far:.2g} sigma)" for row, off, far in zip(rows, off_mm, sigmas, strict=True)]
    more = f" and {len(named) - LISTED} more" if len(named) > LISTED else ""
    yield FindingDocument.make(
        "rows_far_off",
        f"{'Row' if len(rows) == 1 else 'Rows'} {', '.join(named[:LISTED])}{more} miss the prediction by far more "
        f"than is expected there; of the others the median misses by {most:.2g} mm. Look at their joints and positions. Where "
        "they are wrong, send the other rows as a campaign of their own, and retire this one.",
        rows=(rows + 1).tolist(),
        off_mm=off_mm,
        sigmas=sigmas.tolist(),
    )


COVERED = 0.9  # share of coordinates below which 95 % intervals do not hold: poses share errors, so no closer
MOST_UNKNOWN = 0.25  # share of rows of unknown sides above which the order tells nothing, and all rows count
MOST_ROWS = 2000  # of a list of poses, evenly chosen


def evaluate(
    calibration: Calibration, observations: Observations, refit: Sequence[str] = (), known: Predictive | None = None
) -> dict[str, Any]:
    """Metrics of a calibration on observations beside those of the nominal robot, of registration alone and without effects.

    ``rows`` has the error of each row, measured minus predicted, and the half width of the 95 % interval in which what is
    ``known`` of the calibration expects it, None without; ``within_u95`` is the share of the coordinates that are there.
    Of rows that are views alone ``left_open`` is how far off the tool may be there by what is known, which views hardly
    show; None of others. Errors leave out rows whose joints with backlash came from a side that nobody knows.

    ``refit`` names the frames fitted anew to these observations: [], ["base"] or ["base", "tool"] (the tracker was set
    up anew). ``registration_only`` fits both frames of the nominal robot, whatever ``refit`` says. ``without_effects`` is the
    calibration with its effects left out and nothing else fitted anew, there where it has effects.

    Raises:
        OptionError: another refit. TooFewPosesError: too few poses for it. ObservationError: nothing measured.

    """
    anew = new_frames(refit, "refit")
    unknown = calibration.unknown_sides(observations)
    counted = ~unknown if unknown.mean() <= MOST_UNKNOWN else np.ones(len(unknown), dtype=bool)
    measurement = Measurement.from_observations(observations.select(counted), calibration.marker_points, held=True)
    nominal = Calibration.nominal(calibration.robot)
    stages = {
        "nominal": nominal,
        "registration_only": refit_frames(nominal, measurement, ("base", "tool")),
        "identified": refit_frames(calibration, measurement, anew),
    }
    rigid = calibration.with_effects([one for one in calibration.model.effects if one.stage == "measurement"])
    if len(rigid.model.effects) < len(calibration.model.effects):
        stages["without_effects"] = refit_frames(rigid, measurement, anew)
    errors = {name: Errors.from_calibration(stage, measurement) for name, stage in stages.items()}
    stages["without"] = refit_frames(nominal, measurement, tuple(refit))
    if not measurement.observes_places:  # what a row misses by is known against the others only
        left, shown = _left_open(stages["identified"], measurement, known), errors["identified"].to_document()["rms_mm"]
        none = Rows(np.zeros((0, 3)), None, np.zeros(0, dtype=np.int64))
        return {
            "n": len(errors["nominal"].points),
            "left_out": 0,
            **{name: e.to_document() for name, e in errors.items()},
            "within_u95": None,
            "left_open": left,
            "rows": none.to_document(),
            "warnings": [
                *_worse(stages, measurement),
                *tell_less({"pixels": {"left_open": left}}, shown, "By these views"),
            ],
        }
    whole = Measurement.from_observations(observations, calibration.marker_points, held=True)
    table = errors_by_row(stages["identified"], whole, refit, known)
    judged = replace(table, error=table.error[counted], u95=None if table.u95 is None else table.u95[counted])
    return {
        "n": len(errors["nominal"].points),
        "left_out": int(np.sum(~counted)),
        **{name: e.to_document() for name, e in errors.items()},
        "within_u95": judged.interval_coverage,
        "left_open": None,
        "rows": table.to_document(),
        "warnings": _warnings(stages, measurement, refit, judged),
    }


def _left_open(calibration: Calibration, measurement: Measurement, known: Predictive | None) -> dict[str, float] | None:
    """Millimetres as an identification to views has them, at these poses; None where something else tells where the tool is."""
    if known is None or not measurement.tool.places_itself:
        return None
    found = left_open(calibration, known, measurement.observations)
    return {"rms_mm": mm(found.rms), "high_mm": mm(found.high)}


def _warnings(
    stages: Mapping[str, Calibration], measurement: Measurement, refit: Sequence[str], table: Rows
) -> list[FindingDocument]:
    """What speaks against the calibration here; nothing does in frames that are not those of the rows."""
    apart = list(elsewhere(stages["identified"], measurement, refit=refit))
    return apart or [*_worse(stages, measurement), *_narrow(table.interval_coverage), *warning(table.error, table.u95)]


def _worse(stages: Mapping[str, Calibration], measurement: Measurement) -> Iterator[FindingDocument]:
    """Warn where these rows are predicted worse than without the calibration, frames fitted alike, or than by frames alone."""
    errors = PoseErrors.from_calibrations(stages, measurement).stages
    found = errors["identified"]
    words = {
        "without": ("worse_than_without", "the nominal robot in frames treated alike", "do not correct with it here."),
        "registration_only": (
            "worse_than_registration",
            "base and tool alone",
            'if the instrument or the tool was set up anew, evaluate with refit ["base", "tool"].',
        ),
    }
    for stage, (code, simpler, advice) in words.items():
        plain = errors[stage]
        if Difference.from_paired_errors(found, plain).worse:
            yield FindingDocument.make(
                code,
                f"These rows are predicted worse with it ({mm(found.mean()):.3g} mm, mean by pose) than with "
                f"{simpler} ({mm(plain.mean()):.3g} mm): {advice}",
                simpler_mm=mm(float(plain.mean())),
                identified_mm=mm(float(found.mean())),
            )
            return


def _narrow(within: float | None) -> Iterator[FindingDocument]:
    """Warn where the intervals of a calibration do not cover these rows."""
    if within is not None and within < COVERED:
        yield FindingDocument.make(
            "intervals_too_narrow",
            f"Only {within:.0%} of the coordinates lie within their 95 % intervals: what the version states of "
            "itself does not hold for these rows.",
            within_u95=within,
        )


@dataclass(frozen=True)
class Rows:
    """Errors (N, 3) m of measured rows, of the mean of their markers or of their point, and ``u95 (N, 3)`` m or None.

    Rows that show no marker have NaN.
    """

    error: Floats
    u95: Floats | None
    pose: Ints

    @property
    def interval_coverage(self) -> float | None:
        """Share of the coordinates whose error is within the interval."""
        seen = ~np.isnan(self.error)
        return None if self.u95 is None else float(np.mean((np.abs(self.error) <= self.u95)[seen]))

    def to_document(self) -> dict[str, Any]:
        """Columns, mm; of many rows some, evenly chosen. Rows and poses are counted from 1."""
        count = len(self.error)
        some = np.unique(np.linspace(0, count - 1, min(count, MOST_ROWS)).round().astype(np.int64))
        out: dict[str, Any] = {"row": (some + 1).tolist(), "pose": (self.pose[some] + 1).tolist()}
        out |= {f"d{axis}_mm": _numbers(self.error[some, k]) for k, axis in enumerate("xyz")}
        u95 = np.full((count, 3), np.nan) if self.u95 is None else self.u95
        return out | {f"u95_{axis}_mm": _numbers(u95[some, k]) for k, axis in enumerate("xyz")}


def errors_by_row(
    calibration: Calibration, measurement: Measurement, refit: Sequence[str] = (), known: Predictive | None = None
) -> Rows:
    """Errors of every row of a measurement, with what was expected of them where their noise is known."""
    left = measurement.residual(calibration.predict(measurement.observations))
    u95 = None if known is None else expected_error_half_widths(calibration, measurement, refit, known)
    return Rows(mean_errors(left), u95, measurement.observations.pose_groups())


def mean_errors(left: Residual) -> Floats:
    """Errors (N, 3) m of the mean of the markers that each row shows, or of its point; NaN where it shows none."""
    seen = ~np.isnan(left.points)
    count = np.where(seen.any(axis=1), seen.sum(axis=1), np.nan)
    return np.asarray(np.where(seen, left.points, 0.0).sum(axis=1) / count)


def expected_error_half_widths(
    calibration: Calibration, measurement: Measurement, refit: Sequence[str], known: Predictive
) -> Floats | None:
    """Half widths (N, 3) m of the 95 % intervals in which ``known`` expects the errors; None where their noise is not known."""
    here = known.judging(measurement)
    return None if here is None else here.of_measured(calibration, measurement, refit)


def _numbers(metres: Floats) -> list[float | None]:
    return [None if np.isnan(v) else mm(float(v)) for v in metres]


rows_of, expected_of = errors_by_row, expected_error_half_widths  # their names until 0.1; gone with 0.3
