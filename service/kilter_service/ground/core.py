"""Modules of the core that are imported when they are first used: the API and the commands start without their kernels.

They load numpy, scipy and compiled code, which a start must not wait for. ``from kilter_service.ground.core import compare``
stands for ``kilter_core.identify.comparison.compare``; what is named after a package begins with ``core_``.
"""

from __future__ import annotations

from kilter_files.ground.later import later

with later(__name__):
    import kilter_core.watch.arm_check as core_watch_check
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
    from kilter_core.correct import correction_needs as core_needs
    from kilter_core.correct import leverage as core_levers
    from kilter_core.correct import program, walker
    from kilter_core.correct import stated as core_stated
    from kilter_core.effects import other_campaigns, registry
    from kilter_core.evaluate import iso9283
    from kilter_core.evaluate import uncertainty as core_uncertainty
    from kilter_core.evaluate.uncertainty import budget as core_budget
    from kilter_core.gap import check as core_check
    from kilter_core.gap import of_type
    from kilter_core.gap.evidence.held_out import holding_out
    from kilter_core.gap.report import next_poses, separation
    from kilter_core.gap.search import requested as core_wanted
    from kilter_core.identify import bar_length, estimate, holdout, setup_frames
    from kilter_core.identify import check as core_identify_check
    from kilter_core.identify import report as core_report
    from kilter_core.identify.comparison import compare
    from kilter_core.identify.fit import row_errors, tukey
    from kilter_core.identify.fleet import versions as core_versions
    from kilter_core.identify.plausibility import another_arm as core_another_arm
    from kilter_core.identify.plausibility import astray_rows, believable, belonging, set_up_changes, sheet_order, units
    from kilter_core.identify.plausibility.views import unrelated_views as core_views
    from kilter_core.identify.rows import measurement_of_rows
    from kilter_core.identify.uncertainty import predictive, workspace
    from kilter_core.measurement import contacts, metrics
    from kilter_core.model import closed_inverse, general_inverse, table_fit
    from kilter_core.model import directions as core_missing_directions
    from kilter_core.model import doubts as core_doubts
    from kilter_core.model import geometry as core_geometry
    from kilter_core.model import region as core_region
    from kilter_core.observations import clock as core_clock
    from kilter_core.plan import d_optimal, iso9283_poses
    from kilter_core.plan import inclinometers as core_inclinometer_poses
    from kilter_core.plan import views as core_view_poses
    from kilter_core.procedures import circle_points, inclinometers, link_encoders, reference_frame
    from kilter_core.watch import history as core_history
