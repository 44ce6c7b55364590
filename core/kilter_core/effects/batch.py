"""The conditions of rows as effects read them: joints, loads, and what was measured beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.load_slopes import LoadSlopes
from kilter_core.observations import Conditions
from kilter_core.observations.clock import on_shared_clock
from kilter_core.types import Floats

WRENCH = (0, 1, 2, 3, 4, 5)
CENTRES = {"wrench": "centre_wrench", "axial": "centre_axial"}
ALL_LOADS = {"axial": (0,), "wrench": WRENCH, "end_wrench": WRENCH, "base_wrench": WRENCH}  # of a batch, by component
NOT_OF_ROWS = ("link_vectors", "blur")  # arrays of a batch that have no row for each of its rows


@dataclass(frozen=True)
class Batch(Conditions):
    """The conditions of N rows as effects may read them, SI.

    ``wrench (N, n, 6)`` is the load on each joint; ``axial (N, n)`` its part that works on the joint: the moment about
    the axis of a revolute joint (N·m), the force along that of a prismatic one (N). ``end_wrench``, ``base_wrench`` and
    ``tool_point`` are those of :class:`~kilter_core.arm.load_wrenches.Loads`, ``link_vectors (n + 1, 3)`` those of the chain.
    ``payload_axial (N, n, 4)`` is what one more kilogram at the payload's place adds to ``axial``, and one more kg·m of
    first moment along each tool axis; it comes with ``payload_kg``. ``slopes`` say how the loads follow errors of the
    masses, where the model has such errors. ``blur (n, 2)`` N·m is how uncertain the load across and about each joint is
    where it changes its sign: a sign is then read as its expectation. ``centre_wrench`` and ``centre_axial`` are the loads
    of the arm with every backlash and clearance in its middle, where those of the arm with its sides differ: what has a side
    takes it by ``sided_moment`` and ``sided_axial``, so that a sign near zero cannot change itself.

    An effect declares what it reads in ``needs``: the loads as "moments", measured columns by name. ``q``,
    ``tool_point`` and ``link_vectors`` are always there; anything not measured is None.
    """

    q: Floats
    wrench: Floats
    axial: Floats
    end_wrench: Floats
    base_wrench: Floats
    tool_point: Floats
    link_vectors: Floats
    payload_axial: Floats | None = None
    slopes: LoadSlopes | None = None
    blur: Floats | None = None
    centre_wrench: Floats | None = None
    centre_axial: Floats | None = None

    def with_loads(self, change: Floats, reads: Mapping[str, tuple[int, ...]] | None = None) -> Batch:
        """The same rows with load errors ``change (K,)`` in the order of ``slopes``.

        ``reads`` gives the components of each load that are wanted; all when None. The others stay as they were.
        """
        assert self.slopes is not None
        loads: dict[str, Any] = {}
        for name, parts in (ALL_LOADS if reads is None else reads).items():
            own = self._load_field_names(name)
            loads |= {k: getattr(self, k).copy() for k in own}
            for part, moved in zip(parts, self.slopes.changes(name, parts, change), strict=True):
                for k in own:
                    here = loads[k] if name == "axial" else loads[k][..., part]
                    here += moved
        return replace(self, **loads)

    def select_rows(self, rows: slice) -> Batch:
        """The conditions of some of the rows, as views."""
        own = {k: v[rows] for k, v in vars(self).items() if isinstance(v, np.ndarray) and k not in NOT_OF_ROWS}
        return replace(self, **own, slopes=None if self.slopes is None else self.slopes.select_rows(rows))

    def before_event_indicator(self, at_s: float | None, at_row: int | None) -> Floats:
        """1 in the rows (N,) measured before an event, 0 in the others and where a row does not say: the last state holds.

        Rows on another clock do not say.
        """
        key, mark = (self.row, at_row) if at_s is None else (self.t, at_s)
        if key is None or mark is None:
            return np.zeros(len(self))
        before = key < mark
        if at_s is not None:
            before &= on_shared_clock(key) == bool(on_shared_clock(np.array(at_s)))
        return before.astype(np.float64)

    @property
    def moment(self) -> Floats:
        """Load moments (N, n, 3) in the joint frames: x and y across the axis, z about it."""
        return self.wrench[:, :, 3:]

    @property
    def sided_moment(self) -> Floats:
        """As ``moment``, with backlash and clearance in their middle."""
        return self.side_deciding_load("wrench")[:, :, 3:]

    @property
    def sided_axial(self) -> Floats:
        """As ``axial``, with backlash and clearance in their middle."""
        return self.side_deciding_load("axial")

    def _load_field_names(self, name: str) -> tuple[str, ...]:
        """The load of this name, and last that by which sides are taken where it is another."""
        centre = CENTRES.get(name, "")
        return (name,) if getattr(self, centre, None) is None else (name, centre)

    def side_deciding_load(self, name: str) -> Floats:
        """The load of this name by which sides are taken."""
        found: Floats = getattr(self, self._load_field_names(name)[-1])
        return found

    def add_to_load(self, name: str, step: Floats) -> Batch:
        """The same rows with ``step`` added to the load of this name, whoever reads it."""
        loads: dict[str, Any] = {k: getattr(self, k) + step for k in self._load_field_names(name)}
        return replace(self, **loads)

    def __len__(self) -> int:
        return int(self.q.shape[0])
