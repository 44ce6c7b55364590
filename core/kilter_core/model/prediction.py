"""What a model predicts of rows: where the tool is, what its joints rotate by, and the derivatives.

Load errors in a model: the loads the other effects read, and how their corrections follow errors of the masses.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.kernels import kinematics as kernel
from kilter_core.arm.load_slopes import LoadSlopes
from kilter_core.effects import BASE, TOOL, Batch, Derivative, Effect, Local
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

    def put_effects(self, out: Floats, total: Total, places: Mapping[int, int], position: Floats) -> None:
        """Add the local derivatives of effects to the columns ``places`` of ``out (N, 6, K)``, by their parameters."""
        for start, local in total.parts:
            for d in local.derivatives:
                column = places.get(start + d.parameter)
                if column is None:
                    continue
                self.put(out, column, d)
                if d.scale is not None:
                    assert total.stretch is not None
                    # The stretch that multiplies all columns afterwards must not multiply its own derivative.
                    out[:, :3, column] += position / total.stretch * d.scale[:, None]

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


STEP = (
    1e-3  # of the rms load over which slopes are taken: effects are linear in the loads, or smooth over more than that
)
LEAST_NM = 1e-9
NEAR = 3.0  # standard deviations from zero within which the sign of a load is in doubt


@dataclass(frozen=True)
class Slope:
    """Derivative of the corrections ``local`` by component ``part`` of the loads ``name``, each joint by its own load."""

    name: str
    part: int
    local: Local


@dataclass(frozen=True)
class Reader:
    """Effects of a model with their places among its values, as ``slices`` lists them."""

    effects: Sequence[Effect]
    slices: Mapping[str, slice]

    def __iter__(self) -> Iterator[tuple[Effect, slice]]:
        return zip(self.effects, self.slices.values(), strict=True)

    def apply_load_errors(self, batch: Batch, values: Floats) -> Batch:
        """The batch with the loads that the load errors in ``values`` leave."""
        change = self._change(batch, values)
        return batch if change is None else batch.with_loads(change)

    def read(self, batch: Batch, values: Floats, effects: Iterable[Effect]) -> Batch:
        """The same with those loads alone that any of the ``effects`` reads: all of them take most of a fit's time."""
        change = self._change(batch, values)
        if change is None:
            return batch
        following = [e for e in effects if "moments" in e.needs and not e.changes_loads]
        if not all(e.reads for e in following):  # one that names none may read any
            return batch.with_loads(change)
        named: dict[str, set[int]] = {}
        for name, parts in (read for e in following for read in e.reads):
            named.setdefault(name, set()).update(parts)
        return batch.with_loads(change, {name: tuple(sorted(parts)) for name, parts in named.items()})

    def _change(self, batch: Batch, values: Floats) -> Floats | None:
        """Load errors (K,) in ``values``; None without any."""
        if batch.slopes is None:
            return None
        change = np.zeros(len(batch.slopes))
        for place, column in self._places(batch):
            change[column] += values[place]
        return change if np.any(change) else None

    def load_errors(self, batch: Batch, wanted: Container[int]) -> list[tuple[int, int]]:
        """Parameter and load error, of those among the ``wanted`` parameters that these rows have."""
        return [] if batch.slopes is None else [(p, c) for p, c in self._places(batch) if p in wanted]

    def slopes(self, here: Batch, values: Floats) -> Iterator[Slope]:
        """How the corrections of effects with values follow the loads of the batch: exact where they are linear in them."""
        for effect, where in self:
            if effect.reads and np.any(values[where]):
                yield from _slopes(effect, here, values[where])

    def _places(self, batch: Batch) -> Iterator[tuple[int, int]]:
        """Parameter and load error of each effect that changes loads."""
        assert batch.slopes is not None
        for effect, where in self:
            if effect.changes_loads:
                columns = effect.load_columns(batch.slopes)
                yield from ((where.start + k, c) for k, c in enumerate(columns) if c >= 0)


def _slopes(effect: Effect, batch: Batch, values: Floats) -> Iterator[Slope]:
    for name, parts in effect.reads:
        load = getattr(batch, name)
        for part in parts:
            step = np.zeros_like(load)
            here = ... if name == "axial" else (..., part)
            step[here] = max(STEP * float(np.sqrt(np.mean(load[here] ** 2))) if load.size else 0.0, LEAST_NM)
            ahead, behind = (effect.local(batch.add_to_load(name, way * step), values) for way in (1.0, -1.0))
            width = float(step[here].flat[0]) if load.size else 0.5
            near = np.abs(batch.side_deciding_load(name)[here]) <= width
            slope = _over(ahead, behind, 2.0 * width)
            yield Slope(name, part, slope if effect.smooth_over(width) else _without_steps(slope, near))


def _without_steps(slope: Local, across: Bools) -> Local:
    """The slope without the rows (N, n) in which a sign changes within the step: nothing follows a step but by chance."""
    for moved in (slope.dq, slope.xi):
        if moved is not None:
            moved[across] = 0.0
    return slope


def _over(ahead: Local, behind: Local, width: float) -> Local:
    def slope(one: Floats | None, other: Floats | None) -> Floats | None:
        return None if one is None or other is None else (one - other) / width

    return Local(slope(ahead.dq, behind.dq), slope(ahead.xi, behind.xi), slope(ahead.base, behind.base))


def load_sign_blur(effects: Iterable[Effect], batch: Batch, covariance: Floats) -> Floats:
    """Standard deviation (n, 2) N·m of the load across and about each joint, in the rows where its sign is in doubt.

    ``covariance`` is that of the load errors of the one effect among ``effects`` that is a nuisance, SI; ``batch`` has the
    loads that its values leave.
    """
    slopes = batch.slopes
    assert slopes is not None
    columns = next(e for e in effects if e.nuisance).load_columns(slopes)
    known = [k for k, c in enumerate(columns) if c >= 0]
    kept = [columns[k] for k in known]
    C = covariance[np.ix_(known, known)]

    def doubtful_deviations(name: str, part: int, load: Floats) -> list[float]:
        """Deviations (n,) of one component, in the rows where its sign is in doubt."""
        by = slopes.component_slopes(name, part)[kept]
        sigma = np.sqrt(np.maximum(np.einsum("knj,knj->nj", by, np.tensordot(C, by, axes=1)), 0.0))
        return [_median_sigma_near_zero(load[:, j], sigma[:, j]) for j in range(load.shape[1])]

    across = [doubtful_deviations("wrench", 3 + a, batch.sided_moment[:, :, a]) for a in range(2)]
    return np.stack([np.max(across, axis=0), doubtful_deviations("axial", 0, batch.sided_axial)], axis=1)


def _median_sigma_near_zero(load: Floats, sigma: Floats) -> float:
    near = np.abs(load) < NEAR * sigma
    return float(np.median(sigma[near])) if near.any() else 0.0
