"""Derivatives of what the joints rotate by, whatever the tool does: encoders on the links and inclinometers see them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.loads.slopes import LoadSlopes
from kilter_core.effects import BASE, TOOL, Batch, Derivative, Local
from kilter_core.model.load_errors import Reader, Slope
from kilter_core.model.prediction import ABOUT, JOINT_ROWS, Total
from kilter_core.types import Floats, Ints


def joint_rows(reader: Reader, batch: Batch, total: Total, values: Floats, columns: tuple[Ints, int]) -> Floats:
    """Derivatives (N, 4 n + 4, F) of what the joints and the base rotate by, by the parameters of ``columns``.

    These are the free ones, of which only effects and load errors move any: those from the second number on.
    """
    free, first = columns
    place = {int(k): c for c, k in enumerate(free) if k >= first}
    out = JointColumns.from_shape(len(batch), batch.q.shape[1], len(free))
    for start, local in total.parts:
        for d in local.derivatives:
            if start + d.parameter in place:
                out.put(place[start + d.parameter], d)
    errors = [(place[k], error) for k, error in reader.load_errors(batch, place)]
    if errors and batch.slopes is not None:
        out.put_loads(reader.slopes(batch, values), batch.slopes, errors)
    return out.rows


def rotation_derivatives(found: Sequence[Derivative], rows: int, joints: int) -> Floats:
    """What each of the derivatives rotates (N, 4 n + 4, K)."""
    out = JointColumns.from_shape(rows, joints, len(found))
    for k, d in enumerate(found):
        out.put(k, d)
    return out.rows


def own_turns(rows: int, joints: int) -> Floats:
    """Derivatives (N, 4 n + 4, n) by a turn of each joint beyond its reading."""
    own = np.zeros((joints + 1, JOINT_ROWS, joints))
    each = np.arange(joints)
    own[each, ABOUT, each] = own[each, -1, each] = 1.0
    return np.broadcast_to(own.reshape(1, -1, joints), (rows, own.shape[0] * JOINT_ROWS, joints))


@dataclass(frozen=True)
class JointColumns:
    """Derivatives ``rows (N, 4 n + 4, F)`` of what each joint, and last the base, rotates by beyond its command.

    Of each: the correction of its angle, then its rotation about x, y and z of its frame, the correction about z included.
    """

    rows: Floats

    @staticmethod
    def from_shape(rows: int, joints: int, columns: int) -> JointColumns:
        """Zeros, to be added to."""
        return JointColumns(np.zeros((rows, 4 * (joints + 1), columns)))

    def put(self, column: int, d: Derivative) -> None:
        """Add what a derivative moves; what acts on the tool moves no joint."""
        if d.joint == TOOL:
            return
        at = self._place(d.joint)
        if d.dq is not None:
            self.rows[:, at, column] += d.dq
            self.rows[:, at + 3, column] += d.dq
        if d.xi is not None:
            self.rows[:, at + 1 : at + 4, column] += d.xi[:, 3:]

    def put_loads(self, slopes: Iterable[Slope], by: LoadSlopes, errors: Sequence[tuple[int, int]]) -> None:
        """Add what load errors move through the ``slopes``; ``errors`` are columns and load errors."""
        for slope in slopes:
            load = by.component_slopes(slope.name, slope.part)
            for moved, joint in self._by_loads(slope.local):
                at, own = self._place(joint), load if joint == BASE else load[..., joint]
                for column, error in errors:
                    self.rows[:, at : at + 4, column] += moved * own[error][:, None]

    def _by_loads(self, local: Local) -> Iterator[tuple[Floats, int]]:
        """Rotations (N, 4) by the load of each joint, and of the base."""
        for j in range(self.rows.shape[1] // 4 - 1):
            moved = np.zeros((len(self.rows), 4))
            if local.dq is not None:
                moved[:, 0] += local.dq[:, j]
                moved[:, 3] += local.dq[:, j]
            if local.xi is not None:
                moved[:, 1:] += local.xi[:, j, 3:]
            if np.any(moved):
                yield moved, j
        if local.base is not None:
            yield np.hstack([np.zeros((len(self.rows), 1)), local.base[:, 3:]]), BASE

    def _place(self, joint: int) -> int:
        """First row of a joint or the base."""
        return self.rows.shape[1] - 4 if joint == BASE else 4 * joint
