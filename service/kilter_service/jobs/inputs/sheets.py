"""Checks of drawn sheets before the fit, whether their quarter points were given in the right order; of ball bars after it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import ObservationError
from kilter_service.ground.core import core_identify, core_model
from kilter_service.ground.wire import to_mm
from kilter_service.jobs.inputs.setups import LAID_AGAIN

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.identify import Identification, SheetOrder
    from kilter_core.observations import Observations

    Again = Callable[[str, Observations], Identification | None]

OPTION, GIVEN = "sheet_order", "given"


def doubts(
    robot: Robot, campaigns: Iterable[tuple[str, Observations]], devices: dict[str, str], option: object
) -> list[dict[str, Any]]:
    """Warnings about the order of the quarter points of every drawn sheet.

    Raises:
        ObservationError: an order in which the sheet cannot have been drawn by this robot.

    """
    drawn = [
        (campaign if session is None else f"{campaign} session {session}", sheet)
        for campaign, rows in campaigns
        if option != GIVEN and devices.get(campaign, "").strip().lower() in LAID_AGAIN
        for session, sheet in _sheets(rows)
    ]
    return list(_check_sheet_orders(robot, drawn)) if drawn else []


def bar_lengths(
    found: Identification, robot: Robot, campaigns: Iterable[tuple[str, Observations]], again: Again
) -> list[dict[str, Any]]:
    """Warnings about ball bars of another length than was read, after the fit: the nominal arm only raises the question.

    ``again(campaign, rows)`` is the same identification with other rows of a campaign, None of one that was not fitted.
    """
    nominal = core_model.Calibration.nominal(robot)
    asked = [(name, rows, *one) for name, rows in campaigns for one in core_identify.other_lengths(nominal, rows)]
    out = []
    for campaign, rows, bar, read, length in asked:
        other = again(campaign, core_identify.scale_bar_readings(rows, bar, length / read))
        if other is None:
            wrong = bar in {number for number, _, _ in core_identify.other_lengths(found.calibration, rows)}
        else:
            wrong = core_identify.explains_better(other.fit, found.fit)
        if wrong:
            out.append(_other_length(campaign, bar, read, length))
    return out


def _other_length(campaign: str, bar: int, read: float, found: float) -> dict[str, Any]:
    return {
        "code": "bar_length_doubtful",
        "message": f"{campaign}: bar {bar} reads {to_mm(read):.3f} mm, but the joints put the tool {to_mm(found):.3f} mm "
        f"from the ball at its fixed end ({found / read:.4g} times), and the rows fit that length better. Is the stated "
        "nominal length wrong? Give the right one (kilter measure ballbar-join --radius-mm, or the line above the "
        "log) and upload "
        "again.",
    }


def _sheets(rows: Observations) -> Iterator[tuple[int | None, Observations]]:
    if rows.session is None:
        yield None, rows
        return
    for session in np.unique(rows.session):
        yield int(session), rows.select(rows.session == session)


def _check_sheet_orders(robot: Robot, drawn: list[tuple[str, Observations]]) -> Iterator[dict[str, Any]]:
    """Judge all sheets together: they are of one arm, and an order that helps one of them must not spoil another."""
    for (name, _), found in zip(drawn, core_identify.sheet_orders(robot, [sheet for _, sheet in drawn]), strict=True):
        if found is None:
            continue
        if found.wrong:
            raise ObservationError(
                f"{name} was joined with its quarter points in the wrong order: {found.sentence()}. If you know that the "
                f'order is right, say so with the option {OPTION} "{GIVEN}".',
                code="sheet_order_wrong",
                order=list(found.order),
            )
        if found.doubtful or found.unseen:
            yield {"code": "sheet_order_doubtful", "message": _doubt(name, found)}


def _doubt(name: str, found: SheetOrder) -> str:
    if found.doubtful:
        order = ", ".join(map(str, found.order))
        return (
            f"{name}: its line fits this robot better with the quarter points in the order {order} "
            f"({to_mm(found.left):.3f} mm are left, {to_mm(found.as_given):.3f} mm as given). Check which point was the first."
        )
    return (
        f"{name}: its line fits this robot in several orders of the quarter points equally well, so the order was not checked. "
        "Make sure that row 1 of the points file is point 1; strokes across the line and a larger circle tell more."
    )
