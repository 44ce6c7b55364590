"""Rows of the correction's program from what the effects do at run time: names to columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from kilter_core.arm.run_time import BendingRow, Curve, RunTimeForm, Shape
from kilter_core.correct.kernels import layout
from kilter_core.model.calibration import Doubt
from kilter_core.types import Floats

_SHAPES: Mapping[Shape, float] = {
    Shape.WAVE: layout.WAVE,
    Shape.LINEAR: layout.LINEAR,
    Shape.SPRING: layout.SPRING,
    Shape.SINES: layout.SINES,
    Shape.LAG: layout.LAG,
    Shape.POLYNOMIAL: layout.POLYNOMIAL,
}
_JOINT: Mapping[str, int] = {
    "offset": layout.DQ,
    "tilt": layout.TILT,
    "tilt_by_vector": layout.TILT_SHARE,
    "tilt_softening_nm": layout.TILT_OWN,
    "backlash": layout.PLAY,
    "backlash_softening_nm": layout.PLAY_OWN,
    "reversal": layout.REVERSAL,
    "compliance": layout.COMPLIANCE,
    "compliance_by_direction": layout.SIDED,
    "hardening": layout.HARDENING,
    "radial_compliance": layout.RADIAL,
}


def joint_rows(form: RunTimeForm, widths: tuple[Floats, Floats]) -> Floats:
    """Rows (n, COLUMNS) of the joints; ``widths`` (n,) N·m of the signs of the load across and about them."""
    rows = np.zeros((len(form.joints), layout.COLUMNS))
    for j, (row, joint) in enumerate(zip(rows, form.joints, strict=True)):
        for name, column in _JOINT.items():
            row[column] = getattr(joint, name)
        row[layout.TILT_SOFT] = widths[0][j]
        row[layout.PLAY_SOFT] = widths[1][j]
        row[layout.XI : layout.XI + 6] = joint.twist
        row[layout.TWISTED] = j in form.twisted
    return rows


def curve_rows(form: RunTimeForm) -> Floats:
    """Rows (curves, COLUMNS), one for each curve."""
    return np.array([_curve(curve) for curve in form.curves]).reshape(-1, layout.COLUMNS)


def _curve(curve: Curve) -> Floats:
    row = np.zeros(layout.COLUMNS)
    row[layout.CURVED], row[layout.SHAPE], row[layout.DRIVER] = curve.joint, _SHAPES[curve.shape], curve.driver
    row[layout.AMPLITUDE_A], row[layout.AMPLITUDE_B], row[layout.FACTOR] = curve.a, curve.b, curve.factor
    row[layout.MOVED] = 0 if curve.twist is None else 1 + curve.twist
    row[layout.EXTRA : layout.EXTRA + len(curve.constants)] = curve.constants
    row[layout.POWERS : layout.POWERS + len(curve.powers)] = curve.powers
    if curve.within is not None:
        row[[layout.FROM, layout.TO, layout.FADE, layout.MEAN]] = curve.within
    return row


def bending_rows(form: RunTimeForm) -> Floats:
    """Rows (2 x bending rows, COLUMNS)."""
    return np.array(
        [row for b in form.bending for row in _bending(b, form.robot.joints[b.joint].kind == "revolute")]
    ).reshape(-1, layout.COLUMNS)


def _bending(bending: BendingRow, revolute: bool) -> Floats:
    rows = np.zeros((2, layout.COLUMNS))
    rows[0, :36], rows[1, :36] = bending.of_joint.ravel(), bending.of_end.ravel()
    rows[0, layout.BENDING_JOINT] = bending.joint
    rows[0, layout.BENDING_LINK : layout.BENDING_LINK + 3] = bending.link
    if bending.of_axis:
        rows[0, layout.OF_AXIS] = 6 if revolute else 3
    rows[0, layout.POWER], rows[0, layout.ROOTED], rows[0, layout.WAY] = bending.reach
    return rows


def doubt_rows(doubts: Sequence[Doubt], n: int) -> Floats:
    """Rows (doubts, COLUMNS), one for each box of joint values in which the version is less sure than it says."""
    rows = np.zeros((len(doubts), layout.COLUMNS))
    bounded = min(n, layout.HIGHEST_OF_BOX - layout.LOWEST_OF_BOX)
    for row, doubt in zip(rows, doubts, strict=True):
        row[layout.LOWEST_OF_BOX : layout.LOWEST_OF_BOX + bounded] = doubt.low[:bounded]
        row[layout.HIGHEST_OF_BOX : layout.HIGHEST_OF_BOX + bounded] = doubt.high[:bounded]
    return rows
