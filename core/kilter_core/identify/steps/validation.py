"""Errors on rows that were not fitted, by folds or of rows held out, and the stages of a fit compared on them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kilter_core.errors import FindingDocument
from kilter_core.identify.comparison import PoseErrors, elsewhere, geometry_alone
from kilter_core.identify.fit.robust import RowErrors
from kilter_core.identify.holdout import Folds, fold_splits, select_learned_effects
from kilter_core.identify.measured_rows import (
    KindErrors,
    between_rows,
    measurement_for,
    pool_kind_errors,
    squared_errors_by_kind,
)
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.reference import place_nominal, refuse_contradicted
from kilter_core.identify.setup_frames import OwnFrame, frame_shift, split_by_setup, with_own_frames
from kilter_core.identify.steps.start import Fitted, Study, name_stages
from kilter_core.identify.uncertainty.by_view import beside_tool_error
from kilter_core.identify.view_report import held_views
from kilter_core.identify.views import with_cameras
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.views import ToolErrors
from kilter_core.measurement.frames import Errors, metrics_document
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Each, Ints, Progress

GEOMETRY = "geometry_fitted"  # a stage of errors and of poses, where the model has effects


@dataclass(frozen=True)
class HeldOut:
    """Errors of each stage on rows that were not fitted: all, pose by pose, row by row, by kind, and of the tool in views.

    ``own_frames`` are the set-ups whose base or tool came from these rows.
    """

    errors: dict[str, Errors] = field(default_factory=dict)
    poses: PoseErrors | None = None
    rows: RowErrors | None = None
    kinds: KindErrors = field(default_factory=dict)
    views: ToolErrors | None = None
    own_frames: tuple[OwnFrame, ...] = ()

    @staticmethod
    def from_stages(
        stages: Mapping[str, Calibration], unseen: Measurement, numbers: Ints, remarks: Iterable[FindingDocument] = ()
    ) -> HeldOut:
        """Errors of calibrations on rows with these ``numbers (N,)``; ``remarks`` are warnings of the poses."""
        usual = {name: stage for name, stage in stages.items() if name != GEOMETRY}
        return HeldOut(
            errors={name: Errors.from_calibration(stage, unseen) for name, stage in stages.items()},
            poses=replace(PoseErrors.from_calibrations(stages, unseen), remarks=tuple(remarks)),
            rows=RowErrors.from_stages(usual, unseen, numbers),
            kinds=squared_errors_by_kind(usual, unseen),
        )

    @staticmethod
    def concatenate(parts: Sequence[HeldOut]) -> HeldOut:
        """Pool folds or set-ups; a stage that one of them lacks is left out."""
        names = [name for name in parts[0].errors if all(name in part.errors for part in parts)]
        views = [part.views for part in parts if part.views is not None]
        return HeldOut(
            errors={name: Errors.concatenate([part.errors[name] for part in parts]) for name in names},
            poses=PoseErrors.concatenate([part.poses for part in parts if part.poses is not None]),
            rows=RowErrors.concatenate([part.rows for part in parts if part.rows is not None]),
            kinds=pool_kind_errors([part.kinds for part in parts]),
            views=ToolErrors.concatenate(views) if views else None,
            own_frames=tuple(frame for part in parts for frame in part.own_frames),
        )

    def rms_mm(self, stage: str) -> float | None:
        """Rms error of a stage; None where nothing was held out."""
        return self.errors[stage].to_document()["rms_mm"] if stage in self.errors else None


def cross_validate(study: Study, each: Each, progress: Progress) -> HeldOut | None:
    """Errors on held-out poses and views, pooled over the folds; None where no folds were asked for."""
    if not isinstance(study.validation, Folds):
        return None
    train, options = study.train, study.options
    points = measurement_for(train, options, study.points).marker_points
    folds = []
    for inside, outside in fold_splits(train, study.validation.folds, options.seed):
        shown, unseen = train.select(inside), train.select(outside)
        own = between_rows(options, shown)
        folds.append(replace(study, train=shown, validation=unseen, options=own, points=points, outside=outside))
    return HeldOut.concatenate(each(evaluate_fold, folds, lambda share, stage: progress(share, f"fold {stage}")))


def evaluate_fold(fold: Study, progress: Progress) -> HeldOut:
    """Fit the rows of a fold and predict those that it holds out; another process may do so."""
    train, rows, options = fold.train, fold.validation, fold.options
    assert isinstance(rows, Observations)
    assert fold.outside is not None
    shown = measurement_for(train, options, fold.points)
    unseen = measurement_for(rows, options, fold.points, shown)
    model = select_learned_effects(with_cameras(fold.begin, train, shown), train, options, fold.prior)[0]
    fit = beside_tool_error(fit_by_method(model, shown, options, progress, fold.prior))
    registered = place_nominal(fold.begin, shown.of_tool(), options, fold.prior)
    identified = Calibration(fit.problem.model, fit.values, fold.points)
    stages = _with_geometry(name_stages(fold, shown, registered, identified), model, shown, options)
    return replace(HeldOut.from_stages(stages, unseen, fold.outside), views=held_views(identified, rows, shown))


def hold_out(study: Study, fitted: Fitted) -> HeldOut:
    """Errors on the rows of the study that were held out.

    What a new set-up cannot know, where the robot stands in its frame, is fitted to its own rows for every stage but the
    nominal robot.
    """
    rows, options, frames, train = study.validation, study.options, study.frames, fitted.measurement
    if not isinstance(rows, Observations):
        return HeldOut()
    compared = _with_geometry(fitted.stages, fitted.begin, train, options)
    which = ("base",) if frames is None else frames.own
    numbers = np.arange(len(rows)) if study.outside is None else study.outside
    parts = []
    for code, own in split_by_setup(frames, rows):
        shown = measurement_for(rows.select(own), options, train.marker_points, train)
        here = {
            name: stage if code is None or name == "nominal" else with_own_frames(stage, shown, options.loss, which)
            for name, stage in compared.items()
        }
        remarks = elsewhere(here["identified"], shown) if frames is None else ()
        before, after = fitted.arm.model, here["identified"].model
        ends = {"base": (before.T_base, after.T_base), "tool": (before.T_tool, after.T_tool)}
        shifts = [] if code is None else [frame_shift(code, "validation", *ends[frame], frame) for frame in which]
        parts.append(replace(HeldOut.from_stages(here, shown, numbers[own], remarks), own_frames=tuple(shifts)))
    return replace(HeldOut.concatenate(parts), views=held_views(fitted.stages["identified"], rows, train))


def compare_stages(study: Study, fitted: Fitted, held: HeldOut) -> dict[str, Any]:
    """The ``metrics`` of the contract: errors of each stage on rows fitted and held out.

    Raises:
        OptionError: a held base or tool that the rows contradict.

    """
    errors = {name: Errors.from_calibration(stage, fitted.measurement) for name, stage in fitted.stages.items()}
    fitted_m, registered_m = errors["identified"].mean, errors["registration_only"].mean
    refuse_contradicted(study.options, fitted.begin, fitted.stages["registration_only"], fitted_m, registered_m)
    return metrics_document(errors, held.errors)


def _with_geometry(
    stages: dict[str, Calibration], begin: Calibration, measurement: Measurement, options: IdentifyOptions
) -> dict[str, Calibration]:
    """The stages with the geometry fitted alone, where the model has effects beside it."""
    geometry = geometry_alone(begin, measurement, options)
    return stages if geometry is None else {**stages, GEOMETRY: geometry}
