"""Load errors in a model: the loads the other effects read, and how their corrections follow errors of the masses."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.effects import Batch, Effect, Local
from kilter_core.types import Bools, Floats

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
