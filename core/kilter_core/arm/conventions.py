"""Denavit-Hartenberg, modified Denavit-Hartenberg and Hayati rows into chains of elementary transforms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from kilter_core.arm.chain import Axis, Element

PARALLEL_RAD = math.radians(1.0)  # axes nearer to parallel than this need Hayati's rotation to stay identifiable


@dataclass(frozen=True)
class Row:
    """One row of a DH, MDH or Hayati table, SI. ``beta`` and ``d`` are None where the convention has none."""

    alpha: float
    a: float
    theta_offset: float = 0.0
    d: float | None = 0.0
    beta: float | None = None
    prismatic: bool = False
    gamma: float = 0.0  # S-model only: rotation and shift along the next axis
    b: float = 0.0


def _joint(i: int, row: Row) -> tuple[Element, Element | None]:
    """Return the joint element of row i and the constant partner along the same axis."""
    if row.prismatic:
        return (
            Element(Axis.TZ, row.d or 0.0, f"d_{i + 1}", joint=i),
            Element(Axis.RZ, row.theta_offset, f"theta_offset_{i + 1}"),
        )
    partner = None if row.d is None else Element(Axis.TZ, row.d, f"d_{i + 1}")
    return Element(Axis.RZ, row.theta_offset, f"theta_offset_{i + 1}", joint=i), partner


def _beta(i: int, row: Row, parallel: bool) -> list[Element]:
    """Hayati's rotation about y: as the table says, or added with value 0 where two axes are almost parallel."""
    if row.beta is not None or parallel:
        return [Element(Axis.RY, row.beta or 0.0, f"beta_{i + 1}")]
    return []


def _parallel(alpha: float) -> bool:
    return abs(math.sin(alpha)) < math.sin(PARALLEL_RAD)


def dh_elements(rows: Sequence[Row]) -> tuple[tuple[Element, ...], tuple[int, ...]]:
    """Standard DH, thesis eq. 2.1: Tz(d) Rz(θ) Tx(a) Rx(α) per row.

    Where row i and i+1 rotate about almost parallel axes a rotation Ry(β) of value 0 is added after Rx(α): DH alone is
    singular there (Hayati and Mirmirani 1985). Returns the elements and, per row, the index of the row's frame.
    """
    elements: list[Element] = []
    frames = []
    for i, row in enumerate(rows):
        elements += _dh_row(i, row, last=i + 1 == len(rows))
        frames.append(len(elements) - 1)
    return tuple(elements), tuple(frames)


def _dh_row(i: int, row: Row, *, last: bool) -> list[Element]:
    joint, partner = _joint(i, row)
    ordered = [joint, partner] if row.prismatic else [partner, joint]
    made = [e for e in ordered if e is not None]
    made += [Element(Axis.TX, row.a, f"a_{i + 1}"), Element(Axis.RX, row.alpha, f"alpha_{i + 1}")]
    return made + _beta(i, row, _parallel(row.alpha) and not last)


def s_model_elements(rows: Sequence[Row]) -> tuple[tuple[Element, ...], tuple[int, ...]]:
    """Stone's S-model: Tz(d) Rz(θ) Tx(a) Rx(α) Rz(γ) Tz(b) per row, so that a frame may be anywhere on its axis.

    γ and b say what θ and d of the next row say, so they are parameters in the last row only, which with them places the
    flange freely. Returns the elements and, per row, the index of the row's frame.
    """
    elements: list[Element] = []
    frames = []
    for i, row in enumerate(rows):
        last = i + 1 == len(rows)
        elements += _dh_row(i, row, last=last)
        elements.append(Element(Axis.RZ, row.gamma, f"gamma_{i + 1}" if last else None))
        elements.append(Element(Axis.TZ, row.b, f"b_{i + 1}" if last else None))
        frames.append(len(elements) - 1)
    return tuple(elements), tuple(frames)


def mdh_elements(rows: Sequence[Row]) -> tuple[tuple[Element, ...], tuple[int, ...]]:
    """Craig's MDH, thesis eq. 2.4 corrected: Rx(α) [Ry(β)] Tx(a) Rz(θ) Tz(d) per row, α, a, β being those of i-1.

    A row with β is Hayati's (eq. 3.2 corrected). Returns the elements and, per row, the index of the row's frame.
    """
    elements: list[Element] = []
    frames = []
    for i, row in enumerate(rows):
        elements.append(Element(Axis.RX, row.alpha, f"alpha_{i + 1}"))
        elements += _beta(i, row, _parallel(row.alpha) and i > 0)
        elements.append(Element(Axis.TX, row.a, f"a_{i + 1}"))
        joint, partner = _joint(i, row)
        elements += [e for e in (joint, partner) if e is not None]
        frames.append(len(elements) - 1)
    return tuple(elements), tuple(frames)
