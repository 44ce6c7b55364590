"""Modules of the core that are imported when they are first used: the API and the commands start without their kernels.

They load numpy, scipy and compiled code, which a start must not wait for. ``from kilter_service.ground.core import compare``
stands for ``kilter_core.identify.comparison.compare``; what is named after a package begins with ``core_``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from kilter_files.ground.later import Later

__all__ = [
    "bar_length",
    "believable",
    "belonging",
    "circle_points",
    "closed_inverse",
    "closest_table",
    "compare",
    "contacts",
    "core_another_arm",
    "core_budget",
    "core_check",
    "core_conventions",
    "core_conversions",
    "core_documents",
    "core_effects",
    "core_evaluate",
    "core_frames",
    "core_gap",
    "core_geometry",
    "core_history",
    "core_identify",
    "core_identify_check",
    "core_inclinometer_poses",
    "core_levers",
    "core_measurement",
    "core_model",
    "core_needs",
    "core_parts",
    "core_region",
    "core_report",
    "core_resolved",
    "core_robot",
    "core_stated",
    "core_uncertainty",
    "core_versions",
    "core_view_poses",
    "core_views",
    "core_wanted",
    "core_watch",
    "core_watch_check",
    "d_optimal",
    "estimate",
    "general_inverse",
    "holding_out",
    "holdout",
    "inclinometers",
    "iso9283",
    "iso9283_poses",
    "link_encoders",
    "measurement_of_rows",
    "metrics",
    "next_poses",
    "of_type",
    "predictive",
    "program",
    "reference_frame",
    "registry",
    "row_errors",
    "separation",
    "setups",
    "sheet_order",
    "transforms",
    "tukey",
    "units",
    "walker",
    "workspace",
]

if TYPE_CHECKING:
    import kilter_core.watch.check as core_watch_check
    from kilter_core import effects as core_effects
    from kilter_core import evaluate as core_evaluate
    from kilter_core import gap as core_gap
    from kilter_core import identify as core_identify
    from kilter_core import measurement as core_measurement
    from kilter_core import model as core_model
    from kilter_core import transforms
    from kilter_core import watch as core_watch
    from kilter_core.arm import conventions as core_conventions
    from kilter_core.arm import conversions as core_conversions
    from kilter_core.arm import documents as core_documents
    from kilter_core.arm import frames as core_frames
    from kilter_core.arm import robot as core_robot
    from kilter_core.arm.documents import parts as core_parts
    from kilter_core.arm.documents import resolved as core_resolved
    from kilter_core.correct import levers as core_levers
    from kilter_core.correct import needs as core_needs
    from kilter_core.correct import program, walker
    from kilter_core.correct import stated as core_stated
    from kilter_core.effects import registry
    from kilter_core.evaluate import iso9283
    from kilter_core.evaluate import uncertainty as core_uncertainty
    from kilter_core.evaluate.uncertainty import budget as core_budget
    from kilter_core.gap import check as core_check
    from kilter_core.gap import of_type
    from kilter_core.gap.evidence.held_out import holding_out
    from kilter_core.gap.report import next_poses, separation
    from kilter_core.gap.search import requested as core_wanted
    from kilter_core.identify import bar_length, estimate, holdout, setups
    from kilter_core.identify import check as core_identify_check
    from kilter_core.identify import report as core_report
    from kilter_core.identify.comparison import compare
    from kilter_core.identify.fit import row_errors, tukey
    from kilter_core.identify.fleet import versions as core_versions
    from kilter_core.identify.plausibility import another_arm as core_another_arm
    from kilter_core.identify.plausibility import believable, belonging, sheet_order, units
    from kilter_core.identify.plausibility import views as core_views
    from kilter_core.identify.rows import measurement_of_rows
    from kilter_core.identify.uncertainty import predictive, workspace
    from kilter_core.measurement import contacts, metrics
    from kilter_core.model import closed_inverse, closest_table, general_inverse
    from kilter_core.model import geometry as core_geometry
    from kilter_core.model import region as core_region
    from kilter_core.plan import d_optimal, iso9283_poses
    from kilter_core.plan import inclinometer_poses as core_inclinometer_poses
    from kilter_core.plan import view_poses as core_view_poses
    from kilter_core.procedures import circle_points, inclinometers, link_encoders, reference_frame
    from kilter_core.watch import history as core_history
else:
    core_conventions = Later("kilter_core.arm.conventions")
    core_conversions = Later("kilter_core.arm.conversions")
    core_documents = Later("kilter_core.arm.documents")
    core_parts = Later("kilter_core.arm.documents.parts")
    core_resolved = Later("kilter_core.arm.documents.resolved")
    core_frames = Later("kilter_core.arm.frames")
    core_robot = Later("kilter_core.arm.robot")
    core_levers = Later("kilter_core.correct.levers")
    core_needs = Later("kilter_core.correct.needs")
    program = Later("kilter_core.correct.program")
    core_stated = Later("kilter_core.correct.stated")
    walker = Later("kilter_core.correct.walker")
    core_effects = Later("kilter_core.effects")
    registry = Later("kilter_core.effects.registry")
    core_evaluate = Later("kilter_core.evaluate")
    iso9283 = Later("kilter_core.evaluate.iso9283")
    core_uncertainty = Later("kilter_core.evaluate.uncertainty")
    core_budget = Later("kilter_core.evaluate.uncertainty.budget")
    core_gap = Later("kilter_core.gap")
    core_check = Later("kilter_core.gap.check")
    holding_out = Later("kilter_core.gap.evidence.held_out.holding_out")
    of_type = Later("kilter_core.gap.of_type")
    next_poses = Later("kilter_core.gap.report.next_poses")
    separation = Later("kilter_core.gap.report.separation")
    core_wanted = Later("kilter_core.gap.search.requested")
    core_identify = Later("kilter_core.identify")
    bar_length = Later("kilter_core.identify.bar_length")
    core_identify_check = Later("kilter_core.identify.check")
    compare = Later("kilter_core.identify.comparison.compare")
    estimate = Later("kilter_core.identify.estimate")
    core_versions = Later("kilter_core.identify.fleet.versions")
    holdout = Later("kilter_core.identify.holdout")
    measurement_of_rows = Later("kilter_core.identify.rows.measurement_of_rows")
    core_another_arm = Later("kilter_core.identify.plausibility.another_arm")
    believable = Later("kilter_core.identify.plausibility.believable")
    belonging = Later("kilter_core.identify.plausibility.belonging")
    core_views = Later("kilter_core.identify.plausibility.views")
    sheet_order = Later("kilter_core.identify.plausibility.sheet_order")
    units = Later("kilter_core.identify.plausibility.units")
    core_report = Later("kilter_core.identify.report")
    row_errors = Later("kilter_core.identify.fit.row_errors")
    setups = Later("kilter_core.identify.setups")
    tukey = Later("kilter_core.identify.fit.tukey")
    predictive = Later("kilter_core.identify.uncertainty.predictive")
    workspace = Later("kilter_core.identify.uncertainty.workspace")
    core_measurement = Later("kilter_core.measurement")
    contacts = Later("kilter_core.measurement.contacts")
    metrics = Later("kilter_core.measurement.metrics")
    core_model = Later("kilter_core.model")
    closed_inverse = Later("kilter_core.model.closed_inverse")
    closest_table = Later("kilter_core.model.closest_table")
    general_inverse = Later("kilter_core.model.general_inverse")
    core_geometry = Later("kilter_core.model.geometry")
    core_region = Later("kilter_core.model.region")
    d_optimal = Later("kilter_core.plan.d_optimal")
    core_inclinometer_poses = Later("kilter_core.plan.inclinometer_poses")
    iso9283_poses = Later("kilter_core.plan.iso9283_poses")
    core_view_poses = Later("kilter_core.plan.view_poses")
    circle_points = Later("kilter_core.procedures.circle_points")
    inclinometers = Later("kilter_core.procedures.inclinometers")
    link_encoders = Later("kilter_core.procedures.link_encoders")
    reference_frame = Later("kilter_core.procedures.reference_frame")
    transforms = Later("kilter_core.transforms")
    core_watch = Later("kilter_core.watch")
    core_watch_check = Later("kilter_core.watch.check")
    core_history = Later("kilter_core.watch.history")
