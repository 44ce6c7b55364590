"""What a model predicts of rows: where the tool is, what its joints rotate by, and the derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.kernels import columns as kernel
from kilter_core.arm.loads.slopes import LoadSlopes
from kilter_core.effects import BASE, TOOL, Batch, Derivative, Effect, Local
from kilter_core.model.load_errors import Reader, Slope
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.types import Bools, Floats, Ints

UNTURNED = np.eye(3)  # base and tool have twists in their own axes


@dataclass(frozen=True)
class ToolColumns:
    """Derivatives of N tool poses by the joints, ``JQ (N, 6, n)``, and by the twists behind them, ``JX (N, 6, 6 n + 12)``.

    ``frames (n, 3, 3)`` rotate the frame after each joint's element into the joint frame.
    """

    frames: Floats
    JQ: Floats
    JX: Floats

    def put(self, out: Floats, column: int, d: Derivative) -> None:
        """Add what a derivative moves to a column of ``out (N, 6, K)``."""
        if d.dq is not None:
            kernel.put_turn(out, column, self.JQ, d.joint, np.ascontiguousarray(d.dq, dtype=np.float64))
        if d.xi is not None:
            slot = self._slot(d.joint)
            frame = self.frames[slot] if slot < len(self.frames) else UNTURNED
            kernel.put_twist(out, column, self.JX, slot, frame, np.ascontiguousarray(d.xi, dtype=np.float64))

    def _slot(self, joint: int) -> int:
        n = len(self.frames)
        return {BASE: n, TOOL: n + 1}.get(joint, joint)

    def twist(self, joint: int, xi: Floats) -> Floats:
        """Motion (N, 6) of the tool by a twist (N, 6) at a joint, :data:`BASE` or :data:`TOOL`."""
        slot = self._slot(joint)
        if slot < len(self.frames):
            xi = (xi.reshape(-1, 2, 3) @ self.frames[slot].T).reshape(-1, 6)
        return np.asarray(np.einsum("nij,nj->ni", self.JX[:, :, 6 * slot : 6 * slot + 6], xi))

    def by_loads(self, local: Local) -> Iterator[tuple[Floats, int | None]]:
        """Motion (N, 6) by the load of each joint (its number) and of the base (None), for slopes by the loads."""
        n = self.JQ.shape[2]
        if local.dq is not None:
            moved = np.any(local.dq != 0.0, axis=0)
            yield from ((self.JQ[:, :, j] * local.dq[:, [j]], j) for j in range(n) if moved[j])
        if local.xi is not None:
            moved = np.any(local.xi != 0.0, axis=(0, 2))
            yield from ((self.twist(j, local.xi[:, j]), j) for j in range(n) if moved[j])
        if local.base is not None:
            yield self.twist(BASE, local.base), None

    def put_loads(
        self, out: Floats, slopes: Iterable[Slope], by: LoadSlopes, errors: Sequence[tuple[int, int]]
    ) -> None:
        """Add to columns of ``out`` what load errors move through the ``slopes``; ``errors`` are columns and load errors."""
        places, own = (np.array(k, dtype=np.int64) for k in zip(*errors, strict=True))
        for slope in slopes:
            load = by.component_slopes(slope.name, slope.part)
            for moved, j in self.by_loads(slope.local):
                kernel.put_loads(out, places, np.ascontiguousarray(moved), load if j is None else load[..., j], own)


@dataclass(frozen=True)
class Total:
    """Summed local corrections: ``dq (N, n)``, twists ``xi (N, n + 2, 6)`` (empty when none), position ``stretch (N, 1)``.

    ``frames (n, 3, 3)`` are those of :class:`ToolColumns`, in which the twists of the joints are.
    """

    dq: Floats
    xi: Floats
    stretch: Floats | None
    parts: tuple[tuple[int, Local], ...]
    frames: Floats

    def joint_rotations(self) -> Floats:
        """What each joint, and last the base, rotates by (N, n + 1, 4): its correction, then about the axes of its frame."""
        rows, n = self.dq.shape
        out = np.zeros((rows, n + 1, 4))
        if len(self.xi):
            out[:, :n, 1:] = np.einsum("jba,njb->nja", self.frames, self.xi[:, :n, 3:])
            out[:, n, 1:] = self.xi[:, n, 3:]
        out[:, :n, 0] = self.dq
        out[:, :n, 3] += self.dq
        return out

    @staticmethod
    def from_local_corrections(
        parts: tuple[tuple[int, Local], ...], moves: Sequence[bool], rows: int, frames: Floats
    ) -> Total:
        """Sum the ``parts`` that have values (``moves``), each with the place of its first, over N ``rows``.

        ``frames`` are those of ToolColumns.
        """
        n = len(frames)
        dq, stretch = np.zeros((rows, n)), None
        twisted = any(a is not None for _, local in parts for a in (local.xi, local.base, local.tool))
        xi = np.zeros((rows if twisted else 0, n + 2, 6))
        for (_, local), moving in zip(parts, moves, strict=True):
            if local.scale is not None:
                stretch = (1.0 if stretch is None else stretch) + local.scale[:, None]
            if not moving:  # a search has hundreds of effects without values beside a few with
                continue
            if local.dq is not None:
                dq += local.dq
            if local.xi is not None:
                xi[:, :n] += _in_element_frames(local.xi, frames)
            if local.base is not None:
                xi[:, n] += local.base
            if local.tool is not None:
                xi[:, n + 1] += local.tool
        return Total(dq, xi, stretch, parts, frames)


def _in_element_frames(xi: Floats, frames: Floats) -> Floats:
    """Rotate twists (N, n, 6) from the joint frames into the frames after the joints' elements."""
    if np.array_equal(frames, np.broadcast_to(np.eye(3), frames.shape)):
        return xi
    split = xi.reshape(len(xi), len(frames), 2, 3)
    return np.asarray(np.einsum("jab,njkb->njka", frames, split).reshape(xi.shape))


NOTHING = np.zeros(0, dtype=np.int64)  # no parameter
TOOL_ROWS = 6  # of a Jacobian: position, then rotation vector of the tool
JOINT_ROWS = 4  # of each joint behind them: correction of its angle, then its rotation about x, y and z of its frame
ABOUT, TURNED = 0, slice(1, 4)  # places of these among the four


@dataclass(frozen=True)
class Instrument:
    """Cameras and boards as they stand, and the ``columns (K,)`` of the Jacobian that their unknowns have, -1 for none."""

    rig: PlacedRig
    columns: Ints


def find_instrument(placed: Iterable[tuple[Effect, slice]], values: Floats, free: Ints = NOTHING) -> Instrument | None:
    """The cameras among effects and where their ``values`` are, and the columns they have in a Jacobian by ``free``."""
    for effect, at in placed:
        if effect.instrument is not None:
            columns = np.full(at.stop - at.start, -1, dtype=np.int64)
            own = np.flatnonzero((free >= at.start) & (free < at.stop))
            columns[free[own] - at.start] = own
            return Instrument(effect.instrument.with_values(values[at]), columns)
    return None


@dataclass(frozen=True)
class Prediction:
    """Tool ``position (N, 3)`` m and ``rotation (N, 3, 3)`` in the frame of the measurements.

    ``local`` are the corrections at the joints that it was made with, and ``slides (n,)`` marks prismatic joints.
    ``instrument`` is what is known of the cameras, None where nothing is.
    """

    position: Floats
    rotation: Floats
    local: Total | None = None
    slides: Bools | None = None
    instrument: Instrument | None = None

    def with_rig(self, rig: PlacedRig | None) -> Prediction:
        """The same with cameras that stand as a ``rig`` says, unless the prediction has its own."""
        if rig is None or self.instrument is not None:
            return self
        return replace(self, instrument=Instrument(rig, NOTHING))

    @property
    def joints(self) -> Floats:
        """What each joint, and last the base, rotates by beyond its command (N, n + 1, 4): see :data:`JOINT_ROWS`."""
        assert self.local is not None
        return self.local.joint_rotations()


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
