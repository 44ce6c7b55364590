"""Whether rows belong to a robot: the one question that upload, dry run, page, check, `identify` and `gap` ask alike."""

from __future__ import annotations

from typing import Any

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.identify.plausibility.astray_rows import astray_warnings
from kilter_core.identify.plausibility.lagging import lag_warnings
from kilter_core.identify.plausibility.link_columns import refuse_foreign_links
from kilter_core.identify.plausibility.marker_orders import refuse_feigned_turns
from kilter_core.identify.plausibility.plausibility import refuse_foreign
from kilter_core.identify.plausibility.views.unrelated_views import refuse_unrelated_views
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations

WAY_OUT = "If the rows are right all the same, upload them to a new campaign with --unchecked."
# Refusals that judge how rows look, and may be wrong about them; all others say what rows are not.
JUDGEMENTS = (
    "foreign_observations", "markers_swapped", "corners_misplaced", "intrinsics_differ", "views_astray", "board_scale_differs",
)  # fmt: skip


def refuse_mixed_up(begin: Calibration, rows: Observations) -> tuple[dict[str, Any], ...]:
    """Refuse rows that a mix-up explains far better than physics; return warnings about what only looks odd.

    Give all ``rows`` of a campaign in the order they came, before any are held out: joints of the row above are found
    only where the row above is there. Set-ups of an instrument, each in a frame of its own, are judged one by one. Where
    a person says that rows are right (``unchecked``), what they would be refused for is a warning.

    Raises:
        ObservationError: one of :data:`JUDGEMENTS`, with what looks wrong, how much that explains, and the remedy, which
            was tried; or what is wrong with the columns.

    """
    warnings: list[dict[str, Any]] = []
    try:
        warnings += _judge_tool(begin, rows)
        if rows.pixels is not None:
            warnings += refuse_unrelated_views(begin, rows)
        refuse_foreign_links(begin.robot, rows)
    except ObservationError as error:
        if error.code not in JUDGEMENTS:
            raise
        if rows.unchecked is None or not rows.unchecked.any():
            raise type(error)(f"{error.message} {WAY_OUT}", code=error.code, **error.context) from error
        warnings.append({"code": error.code, "message": f"{error.message} The rows count all the same (--unchecked)."})
    return (*warnings, *lag_warnings(begin.robot, rows))


def _judge_tool(begin: Calibration, rows: Observations) -> list[dict[str, Any]]:
    """Refuse rows of an instrument that cannot be of the arm; what only looks odd in them."""
    warnings: list[dict[str, Any]] = []
    if rows.position is None and rows.markers is None:
        return warnings
    for part in _split_by_setup(rows):
        of_tool = Measurement.from_observations(part, begin.marker_points, held=True).of_tool()
        refuse_feigned_turns(begin, of_tool)
        warnings += [w for w in refuse_foreign(begin, of_tool) if w not in warnings]
    return [*warnings, *astray_warnings(begin, rows)]


def _split_by_setup(rows: Observations) -> list[Observations]:
    if rows.setup is None or len(codes := np.unique(rows.setup)) < 2:
        return [rows]
    return [rows.select(rows.setup == code) for code in codes]
