"""Cross-validation: each fold is a computation of its own, and whoever calls may compute them beside each other."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.identify.comparison.model_comparison import PoseErrors, geometry_alone
from kilter_core.identify.fit.row_errors import RowErrors
from kilter_core.identify.holdout import fold_splits
from kilter_core.identify.learned import select_learned_effects
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.reference import register_nominal
from kilter_core.identify.registry import METHODS
from kilter_core.identify.rows.errors_by_kind import KindErrors, pool_kind_errors, squared_errors_by_kind
from kilter_core.identify.rows.measurement_of_rows import between_rows, measurement_for
from kilter_core.identify.uncertainty.held_arm import beside_held_arm
from kilter_core.identify.view_report import held_views
from kilter_core.identify.views.cameras import with_cameras
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.view_scatter import ToolErrors
from kilter_core.measurement.metrics import Errors
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Each, Floats, Ints, Progress


@dataclass(frozen=True)
class Fold:
    """One fold: everything it needs, so that another process can compute it."""

    nominal: Calibration
    begin: Calibration
    shown: Observations
    unseen: Observations
    outside: Ints
    shape: Floats | None
    options: IdentifyOptions
    prior: Prior | None


@dataclass(frozen=True)
class Held:
    """Errors on the poses that a fold held out."""

    errors: dict[str, Errors]
    poses: PoseErrors
    rows: RowErrors
    kinds: KindErrors
    views: ToolErrors | None


def cross_validated(
    nominal: Calibration,
    begin: Calibration,
    train: Observations,
    folds: int,
    options: IdentifyOptions,
    progress: Progress,
    prior: Prior | None,
    each: Each,
) -> tuple[dict[str, Errors], PoseErrors, RowErrors, KindErrors, ToolErrors | None]:
    """Errors on held-out poses and views, pooled over the folds."""
    shape = measurement_for(train, options, begin.marker_points).marker_points
    tasks = []
    for inside, outside in fold_splits(train, folds, options.seed):
        shown, unseen = train.select(inside), train.select(outside)
        tasks.append(Fold(nominal, begin, shown, unseen, outside, shape, between_rows(options, shown), prior))
    found = each(evaluate_fold, tasks, lambda fraction, stage: progress(0.05 + 0.45 * fraction, f"fold {stage}"))
    # A fold whose rows no geometry alone fits leaves that stage out of all.
    names = [name for name in found[0].errors if all(name in one.errors for one in found)]
    errors = {name: Errors.concatenate([one.errors[name] for one in found]) for name in names}
    poses, rows = (PoseErrors.concatenate([one.poses for one in found]), RowErrors.concatenate([h.rows for h in found]))
    views = [one.views for one in found if one.views is not None]
    seen = ToolErrors.concatenate(views) if views else None
    return errors, poses, rows, pool_kind_errors([one.kinds for one in found]), seen


def evaluate_fold(fold: Fold, progress: Progress) -> Held:
    """Fit what a fold shows and predict what it holds out."""
    shown = measurement_for(fold.shown, fold.options, fold.shape)
    unseen = measurement_for(fold.unseen, fold.options, fold.shape, shown)
    model = select_learned_effects(with_cameras(fold.begin, fold.shown, shown), fold.shown, fold.options, fold.prior)[0]
    fit = beside_held_arm(fit_by_method(model, shown, fold.options, progress, fold.prior))
    found = in_fitted_frames(fold.begin, shown.of_tool(), fold.options, fold.prior)
    stages = {
        "nominal": found if shown.tool.places_itself else fold.nominal,
        "registration_only": found,
        "identified": Calibration(fit.problem.model, fit.values, fold.shape),
    }
    geometry = geometry_alone(model, shown, fold.options)
    compared = stages if geometry is None else {**stages, "geometry_fitted": geometry}
    return Held(
        errors={name: Errors.from_calibration(stage, unseen) for name, stage in compared.items()},
        poses=PoseErrors.from_calibrations(compared, unseen),
        rows=RowErrors.from_stages(stages, unseen, fold.outside),
        kinds=squared_errors_by_kind(stages, unseen),
        views=held_views(stages["identified"], fold.unseen, shown),
    )


def in_fitted_frames(
    begin: Calibration, shown: Measurement, options: IdentifyOptions, prior: Prior | None
) -> Calibration:
    """The nominal robot in fitted frames; where a filter continues, in those of its start: two poses cannot fit any."""
    return (
        begin.nominal_in_wanted_frames() if continues(options, prior) else register_nominal(begin, shown, options.loss)
    )


def continues(options: IdentifyOptions, prior: Prior | None) -> bool:
    """Whether a filter goes on from what is known."""
    return METHODS[options.method].continues and prior is not None
