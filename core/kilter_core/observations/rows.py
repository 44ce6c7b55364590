"""What was measured, as arrays: joint readings, tool positions or poses, and the conditions of each row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import ObservationError
from kilter_core.observations.clock import came_back, read_clock
from kilter_core.observations.repeats import group_means, numbered_poses, numbered_rows
from kilter_core.observations.rig import CONTACTS, INSTRUMENT, Rig, with_same_columns
from kilter_core.types import Bools, Floats, Ints

WHOLE = ("rig", "directions_derived")  # fields that have no row for each of the rows


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Under which each row was measured: what effects may read by name, with the columns that state it.

    ``direction (N, n)`` in {-1, 0, +1} is the last motion of each joint, ``qd`` and ``qdd (N, n)`` are velocities (rad/s or
    m/s) and accelerations; ``t (N,)`` s, ``temperature_c (N,)`` deg C, ``payload_kg (N,)`` kg; ``session (N,)`` numbers the
    times that tracker and markers were set up, ``setup (N,)`` the set-ups of an instrument that each have a frame of
    their own; ``row (N,)`` numbers the rows in the order in which they were measured. ``base_tilt_x`` and ``base_tilt_y
    (N,)`` rad are what an inclinometer on the base read about x and y of the base frame, as inputs of the model.
    """

    direction: Annotated[Floats | None, "dir1 ... dirn"] = None
    qd: Annotated[Floats | None, "qd1_deg_s ... qdn_deg_s"] = None
    qdd: Annotated[Floats | None, "qdd1_deg_s2 ... qddn_deg_s2"] = None
    t: Annotated[Floats | None, "t_s"] = None
    temperature_c: Annotated[Floats | None, "temperature_c"] = None
    payload_kg: Annotated[Floats | None, "payload_kg"] = None
    session: Annotated[Ints | None, "session"] = None
    setup: Annotated[Ints | None, "session"] = None
    row: Annotated[Ints | None, "row"] = None
    base_tilt_x: Annotated[Floats | None, "base_tilt_x_deg"] = None
    base_tilt_y: Annotated[Floats | None, "base_tilt_y_deg"] = None


# The columns of an upload that state each of them.
CONDITIONS: dict[str, str] = {
    name: hint.__metadata__[0] for name, hint in get_type_hints(Conditions, include_extras=True).items()
}


@dataclass(frozen=True)
class Observations(Conditions):
    """Rows of one or more campaigns, SI and radians, batch axis first.

    Shapes: ``q (N, n)``; ``position (N, 3)`` m; ``rotation (N, 3, 3)``; ``markers (N, m, 3)`` m with NaN where a marker
    was not seen; ``tip (N, 3)`` m a point of the tool digitised while the markers were seen, NaN elsewhere; ``link_q
    (N, n)`` the joint angle behind gear and backlash; ``command (N, n)`` where the controller sent the joints; ``sigma
    (N, 3)`` m, the standard deviation of each position coordinate;
    ``wrench (N, 6)`` force N and moment N·m on the tool point in the tool frame; ``payload_com (N, 3)`` m, where the
    payload has its centre in the tool frame, the tool point when None. Without an instrument: ``socket``, ``plane`` and
    ``bar (N,)`` the number of the ball socket, plane or ball bar that the tool's ball is held by in a row, 0 for none;
    ``bar_length (N,)`` m that the bar reads. ``tilt (N, n, 3)`` what each joint rotated about x, y and z of its frame
    beyond its command, up to a constant, as inclinometers read it, NaN where none did; ``tilt (N, n + 1, 3)`` where one
    sits on the base, which comes last. ``link_mass (N, n, 4)`` is a mass kg that hangs on each link beyond what the robot
    states and its place m in the frame of the link, and ``link_wrench (N, n, 6)`` a force N and moment N·m on it.
    ``pixels (N, M, 2)`` px are the corners that a camera saw of a board, NaN where it did not, with standard deviations
    ``pixel_sigma``; ``camera`` and ``board (N,)`` are places in the ``rig``, which describes them, -1 in rows of neither.
    ``pose_weight (N, 6, 6)`` takes what is left of a position (m) and of a rotation vector (rad), in the axes of the
    measurements, to three numbers in m and three in rad that are independent, the three of each equally well known.
    ``directions_derived`` says that ``direction`` is what the order of the rows tells, and that nobody stated it.
    ``unchecked (N,)`` are rows that a person says are right, whatever they look like.
    """

    q: Floats
    position: Floats | None = None
    rotation: Floats | None = None
    markers: Floats | None = None
    link_q: Floats | None = None
    tau: Floats | None = None
    payload_com: Floats | None = None
    pose_id: Ints | None = None
    sigma: Floats | None = None
    pose_weight: Floats | None = None
    tip: Floats | None = None
    wrench: Floats | None = None
    socket: Ints | None = None
    plane: Ints | None = None
    bar: Ints | None = None
    bar_length: Floats | None = None
    tilt: Floats | None = None
    command: Floats | None = None
    link_mass: Floats | None = None
    link_wrench: Floats | None = None
    pixels: Floats | None = None
    pixel_sigma: Floats | None = None
    camera: Ints | None = None
    board: Ints | None = None
    unchecked: Bools | None = None
    rig: Rig | None = None
    directions_derived: bool = False

    def __post_init__(self) -> None:
        for name, value in self._present().items():
            if len(value) != len(self.q):
                raise ObservationError(
                    f"{name} has {len(value)} rows where q has {len(self.q)}: give every row its own value.", field=name
                )

    def __len__(self) -> int:
        return int(self.q.shape[0])

    def select(self, index: NDArray[Any] | slice) -> Observations:
        """Return the rows of ``index`` (integers, a mask or a slice)."""
        rows: dict[str, Any] = {name: value[index] for name, value in self._present().items()}
        return replace(self, **rows)

    @staticmethod
    def concatenate(parts: Sequence[Observations]) -> Observations:
        """Stack campaigns. A column that only some of them have is an error, for a guess would enter the fit.

        Directions that some do not know are 0 there, rows without a session are one; a clock that not all have is left out.

        Raises:
            ObservationError: no parts, or parts with different columns.

        """
        if not parts:
            raise ObservationError("No observations: name at least one campaign that has some.")
        if any(part.tip is not None for part in parts):
            # A tip is digitised once; the other campaigns of the same markers need no columns for it.
            parts = [
                part if part.tip is not None else replace(part, tip=np.full((len(part), 3), np.nan)) for part in parts
            ]
        if any(part.payload_com is not None for part in parts):
            # A payload whose place is not stated hangs at the tool point.
            parts = [
                part if part.payload_com is not None else replace(part, payload_com=np.zeros((len(part), 3)))
                for part in parts
            ]
        if any(part.unchecked is not None for part in parts):
            parts = [
                part if part.unchecked is not None else replace(part, unchecked=np.zeros(len(part), dtype=bool))
                for part in parts
            ]
        parts = with_same_columns(parts)
        names = set(parts[0]._present())
        for part in parts[1:]:
            if set(part._present()) != names:
                odd = sorted(set(part._present()) ^ names)
                mixed = any(name in odd for name in CONTACTS) and any(name in odd for name in INSTRUMENT)
                joined = " or, beside views of a camera, together" if mixed else ""
                raise ObservationError(
                    f"The campaigns differ in their columns ({', '.join(odd)}): identify them apart{joined}, "
                    "or upload the missing columns.",
                    columns=odd,
                )
        return Observations(
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names},
            rig=parts[0].rig,
            directions_derived=any(part.directions_derived for part in parts),
        )

    def carrying(self, payload_kg: float, payload_com: Sequence[float]) -> Observations:
        """Return the rows with this payload (kg, and m in the tool frame) where they state none."""
        if self.payload_kg is not None:
            return self
        com = np.tile(np.asarray(payload_com, dtype=np.float64), (len(self), 1))
        return replace(
            self,
            payload_kg=np.full(len(self), payload_kg),
            payload_com=com if self.payload_com is None else self.payload_com,
        )

    @property
    def stated_direction(self) -> Floats | None:
        """The direction (N, n) of the last motion of each joint, where a column states it."""
        return None if self.directions_derived else self.direction

    def under(self) -> dict[str, Any]:
        """The conditions by name, None where they are not known."""
        return {name: getattr(self, name) for name in CONDITIONS}

    def with_tilt_as_condition(self) -> Observations:
        """What an inclinometer on the base read as a condition of the rows, no longer as a measurement.

        As they are where the condition is stated, or where nothing on the base was read about x and y in every row.
        """
        n = self.q.shape[1]
        if self.base_tilt_x is not None or self.tilt is None or self.tilt.shape[1] <= n:
            return self
        x, y = self.tilt[:, n, 0], self.tilt[:, n, 1]
        if np.isnan(x).any() or np.isnan(y).any():
            return self
        links = self.tilt[:, :n]
        return replace(self, base_tilt_x=x, base_tilt_y=y, tilt=None if np.isnan(links).all() else links)

    @property
    def loads_on_links_vary(self) -> bool:
        """Whether rows differ in what hangs on the links or pulls at them."""
        return any(one is not None and bool(np.any(np.ptp(one, axis=0))) for one in (self.link_mass, self.link_wrench))

    @property
    def tool_seen(self) -> NDArray[np.bool_]:
        """Rows (N,) that say where the tool was; all of them where none has an instrument for it."""
        values = self.markers if self.markers is not None else self.position
        if values is None:
            return np.ones(len(self), dtype=bool)
        return np.asarray(~np.isnan(values).reshape(len(self), -1).all(axis=1))

    @property
    def one_marker_moved(self) -> bool:
        """Whether no row shows three markers: one reflector was moved between nests."""
        return self.markers is not None and bool((~np.isnan(self.markers).any(axis=2)).sum(axis=1).max(initial=0) < 3)

    @cached_property
    def markers_of_poses(self) -> Floats | None:
        """Markers (N, m, 3) m by which rows show the pose of the tool; None without markers.

        Where one reflector was moved between nests, every row has beside its own what the other visits of its pose in the
        same session showed, the mean of them.
        """
        if self.markers is None or not self.one_marker_moved:
            return self.markers
        group, whole = self._markers_by_pose
        return np.asarray(np.where(np.isnan(self.markers), whole[group], self.markers))

    def whole_poses(self) -> Observations:
        """The same with all that the visits of a pose in a session showed in the first of them, and nothing in the others.

        Only where one reflector was moved between nests, for what compares whole visits; the rows keep their numbers.
        """
        if self.markers is None or not self.one_marker_moved:
            return self
        group, whole = self._markers_by_pose
        markers = np.full(self.markers.shape, np.nan)
        markers[np.unique(group, return_index=True)[1]] = whole
        return replace(self, markers=markers)

    @cached_property
    def _markers_by_pose(self) -> tuple[Ints, Floats]:
        """The pose of a session (N,) of each row, and the mean markers (G, m, 3) of each."""
        assert self.markers is not None
        session = np.zeros(len(self)) if self.session is None else self.session
        _, found = np.unique(np.stack([self.pose_groups(), session]), axis=1, return_inverse=True)
        group = found.reshape(-1)
        return group, group_means(self.markers, group)

    def pose_groups(self) -> Ints:
        """Number the poses, shape (N,): rows of one ``pose_id``, else rows with nearly the same joint readings, share one."""
        return self._groups

    @cached_property
    def _groups(self) -> Ints:
        if self.pose_id is not None:
            return np.unique(self.pose_id, return_inverse=True)[1].astype(np.int64)
        return numbered_poses(self.q)

    def conditions(self) -> Ints:
        """Number what repeats must share beside the pose, shape (N,): pose, approach, payload, session and contact."""
        columns = [self.pose_groups().astype(np.float64)[:, None]]
        contact = (self.socket, self.plane, self.bar, self.camera, self.board)
        loads = (self.payload_kg, self.payload_com, self.link_mass, self.link_wrench)
        beside = (self.stated_direction, *loads, self.session, self.setup, *contact)
        columns += [c.reshape(len(c), -1).astype(np.float64) for c in beside if c is not None]
        return numbered_rows(np.unique(np.hstack(columns), return_inverse=True)[1].reshape(len(self), -1))

    def visits(self) -> Ints:
        """Number the visits, shape (N,), in the order of time: rows of one pose that follow each other under the same
        conditions are one.

        A visit ends only where the arm moved in between: where another pose or condition was measured, or joint readings
        show that it left and came back. No pause parts shots, however long: without motion they share how the arm settled.
        """
        clock = read_clock(self)
        condition = self.conditions()[clock.order]
        new = np.ones(len(self), dtype=bool)
        new[1:] = (condition[1:] != condition[:-1]) | came_back(self, clock, condition)
        out = np.empty(len(self), dtype=np.int64)
        out[clock.order] = np.cumsum(new) - 1
        return out

    def _present(self) -> dict[str, NDArray[Any]]:
        return {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in WHOLE and getattr(self, f.name) is not None
        }
