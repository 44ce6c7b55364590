"""Markers on the tool: the shape they share, and whether they are what their numbers say.

Poses from three or more markers on the tool: the shape they share, and its rigid fit to each row.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.measurement.kind import POINTS, Block, Rows, ToolKind
from kilter_core.model import Prediction
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.transforms import skew
from kilter_core.types import Bools, Floats


def resolve_marker_shape(observations: Observations, known: Floats | None) -> Floats | None:
    """Places (m, 3) m of the markers in the tool frame: as ``known``, else as the rows show them; None without any.

    Raises:
        ObservationError: markers that are not a rigid set.

    """
    markers = observations.markers_of_poses
    if markers is None:
        return None
    refuse_bad_markers(markers, known)
    return marker_shape(markers, observations.tip) if known is None else known


@dataclass(frozen=True)
class Markers(ToolKind):
    """Rows with markers that stand at ``shape (m, 3)`` m in the tool frame."""

    name = "markers"
    summary = "markers on the tool"
    with_orientation = True

    observations: Observations
    shape: Floats

    @classmethod
    def from_rows(cls, rows: Rows) -> Markers | None:
        """Rows that have markers of a known shape."""
        if rows.relative or rows.observations.markers is None or rows.marker_points is None:
            return None
        return cls(rows.observations, rows.marker_points)

    @property
    def column(self) -> Floats:
        """Places of the markers; three or more fix the orientation."""
        assert self.observations.markers is not None
        return self.observations.markers

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted markers (N, m, 3) m, NaN where one was not seen."""
        points, d_points = marker_residuals(self.column, self.shape, prediction, J)
        return (Block(POINTS, points, d_points),)


def marker_residuals(
    markers: Floats, shape: Floats, prediction: Prediction, J: Floats | None
) -> tuple[Floats, Floats | None]:
    """Residuals (N, m, 3) m of markers, and the derivative (N, m, 3, P) of the predicted ones."""
    arms = np.einsum("nij,mj->nmi", prediction.rotation, shape)
    points = markers - prediction.position[:, None, :] - arms
    if J is None:
        return points, None
    n, m = markers.shape[:2]
    crossed = -skew(arms.reshape(-1, 3)).reshape(n, m, 3, 3) @ J[:, None, 3:6, :]
    return points, J[:, None, :3, :] + crossed


Order = tuple[int, ...]

MOST_SEARCHED = 6  # markers, 720 orders
ENOUGH = 200  # rows that an order is judged by
CLEARLY = 3.0  # an order must fit so many times better than the one given
OFF = 0.01  # share of the set's size from which a distance counts as another
OFF_M = 5e-4
LOOSE = 0.02  # share of a distance: its scatter from which the set is not a rigid body
BENDS_M = 1e-4  # scatter of a distance worth a warning
OFTEN = 3.0  # scatters of an instrument's own noise that a distance may have
SOLID = 0.05  # thickness of a set, as a share of its size, from which its mirror image is another set


def refuse_bad_markers(markers: Floats, known: Floats | None = None) -> None:
    """Check marker sets (N, m, 3), also against a ``known`` shape (m, 3) of the same markers.

    Raises:
        ObservationError: ``markers_swapped``, ``markers_mirrored`` or ``markers_not_rigid``, naming rows and markers.

    """
    if markers.shape[1] < 3 or len(markers) == 0:
        return
    if known is not None and known.shape[0] != markers.shape[1]:
        raise ObservationError(
            f"The rows have {markers.shape[1]} markers, the shape they are compared with {len(known)}: use the same markers, "
            "or identify without a start."
        )
    distances = _distances(markers)
    if known is not None:
        _refuse_other_order(distances, _distances(known[None])[0])
        _refuse_mirror_image(markers, known)
    _refuse_swaps(distances)
    _refuse_loose(distances)


def bending(markers: Floats, noise_m: float | None) -> tuple[int, int, float] | None:
    """The two markers (from 1) whose distance scatters most, and its standard deviation m, where it is worth a warning."""
    distances = _distances(markers)
    scatter = _scatter(distances)
    a, b = divmod(int(np.nanargmax(scatter)), len(scatter))
    worst = float(scatter[a, b])
    limit = BENDS_M if noise_m is None else max(OFTEN * np.sqrt(2.0) * noise_m, 0.2 * BENDS_M)
    return (min(a, b) + 1, max(a, b) + 1, worst) if worst > limit else None


def equal_markers(markers: Floats) -> tuple[int, int] | None:
    """Two markers (from 1) that are equal to the last digit in every row that shows both: a column was copied."""
    for a, b in combinations(range(markers.shape[1]), 2):
        both = ~np.isnan(markers[:, [a, b]]).any(axis=(1, 2))
        if both.any() and np.array_equal(markers[both, a], markers[both, b]):
            return a + 1, b + 1
    return None


def alike_orders(shape: Floats) -> list[tuple[Order, Floats]]:
    """Other orders of the markers in which the shape fits itself; each with the rotation (3, 3) that it imitates."""
    if len(shape) > MOST_SEARCHED:
        return []
    size, out = float(np.linalg.norm(shape - shape.mean(axis=0), axis=1).max()), []
    for order in permutations(range(len(shape))):
        if order == tuple(range(len(shape))):
            continue
        other = shape[list(order)]
        position, rotation, _ = fit_poses(shape, other[None])
        left = other - (shape @ rotation[0].T + position[0])
        if np.abs(left).max() < 0.05 * size:
            out.append((order, rotation[0]))
    return out


def format_exchanged_markers(order: Order) -> str:
    """Say which markers an order exchanges."""
    moved = [k + 1 for k, at in enumerate(order) if at != k]
    return " and ".join(str(k) for k in moved) if len(moved) == 2 else ", ".join(str(k) for k in moved)


def _distances(markers: Floats) -> Floats:
    return np.asarray(np.linalg.norm(markers[:, :, None] - markers[:, None, :], axis=3))


def _largest_distance_change(distances: Floats, reference: Floats) -> Floats:
    """Largest difference (N,) of a row's distances from the reference; zero where nothing can be compared."""
    gap = np.abs(distances - reference)
    return np.asarray(np.max(np.where(np.isnan(gap), 0.0, gap), axis=(1, 2)))


def _median(distances: Floats, otherwise: Floats | None = None) -> Floats:
    """Median (m, m) over the rows that show both markers; ``otherwise``, or NaN, where none does."""
    unseen = np.isnan(distances).all(axis=0)
    middle = np.nanmedian(np.where(unseen, 0.0, distances), axis=0)
    return np.asarray(np.where(unseen, np.nan if otherwise is None else otherwise, middle))


def _limit(reference: Floats) -> float:
    return max(OFF * float(np.nanmax(reference)), OFF_M)


def _orders(m: int) -> Iterator[Order]:
    if m <= MOST_SEARCHED:
        yield from (order for order in permutations(range(m)) if order != tuple(range(m)))


def _best_order(distances: Floats, reference: Floats) -> tuple[Order, float] | None:
    """The order of the markers in which rows fit the reference best, and their largest typical difference."""
    distances = distances[:: max(1, len(distances) // ENOUGH)]
    found = [
        (order, float(np.median(_largest_distance_change(distances[:, order][:, :, order], reference))))
        for order in _orders(len(reference))
    ]
    return min(found, key=lambda pair: pair[1]) if found else None


def _refuse_other_order(distances: Floats, reference: Floats) -> None:
    off = float(np.median(_largest_distance_change(distances, reference)))
    best = _best_order(distances, reference) if off > _limit(reference) else None
    if best is None or CLEARLY * best[1] > off:
        return
    odd = _is_odd(best[0])
    raise ObservationError(
        f"Markers {format_exchanged_markers(best[0])} are numbered "
        f"{'the other way round' if odd else 'in another order'} than in the rows "
        "they are compared with: number them alike, or identify without a start.",
        code="markers_mirrored" if odd else "markers_swapped",
        order=[k + 1 for k in best[0]],
    )


def _refuse_mirror_image(markers: Floats, known: Floats) -> None:
    s = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)
    if len(known) < 4 or s[2] < SOLID * s[0]:
        return
    seen = markers[~np.isnan(markers).any(axis=(1, 2))]
    if len(seen) == 0:
        return
    as_is, mirrored = (
        float(np.median(_largest_shape_residual(shape, seen))) for shape in (known, known * np.array([1.0, 1.0, -1.0]))
    )
    if as_is > _limit(_distances(known[None])[0]) and CLEARLY * mirrored < as_is:
        raise ObservationError(
            "The markers are the mirror image of the rows they are compared with: two coordinates are exchanged or one has "
            "the other sign, or the markers are numbered the other way round. Correct the export.",
            code="markers_mirrored",
        )


def _largest_shape_residual(shape: Floats, markers: Floats) -> Floats:
    """Largest distance (N,) m of a row's markers from the shape laid over them."""
    position, rotation, _ = fit_poses(shape, markers)
    laid = position[:, None] + np.einsum("nij,mj->nmi", rotation, shape)
    return np.asarray(np.linalg.norm(markers - laid, axis=2).max(axis=1))


def _refuse_swaps(distances: Floats) -> None:
    reference = _median(distances[: max(1, min(5, len(distances) // 4))], _median(distances))
    off = _largest_distance_change(distances, reference) > _limit(reference)
    best = _best_order(distances[off], reference) if off.any() else None
    if (
        best is None
        or best[1] > _limit(reference)
        or CLEARLY * best[1] > np.median(_largest_distance_change(distances[off], reference))
    ):
        return
    rows = np.flatnonzero(off)
    raise ObservationError(
        f"From row {rows[0] + 1} on markers {format_exchanged_markers(best[0])} have changed places ({len(rows)} of "
        f"{len(off)} rows): number "
        "them as before, or use the rows before it only.",
        code="markers_swapped",
        row=int(rows[0]) + 1,
        rows=len(rows),
        order=[k + 1 for k in best[0]],
    )


def _refuse_loose(distances: Floats) -> None:
    scatter, length = _scatter(distances), np.nan_to_num(_median(distances))
    share = scatter / np.where(length > 0.0, length, np.inf)
    a, b = divmod(int(np.nanargmax(share)), len(share))
    if share[a, b] > LOOSE and scatter[a, b] > 2.0 * OFF_M:
        raise ObservationError(
            f"The distance of markers {min(a, b) + 1} and {max(a, b) + 1} varies by {mm(scatter[a, b]):.2f} mm (standard "
            f"deviation) over the rows, {share[a, b]:.1%} of it: the markers are not a rigid body. {_loosest(share)}",
            code="markers_not_rigid",
            markers=[min(a, b) + 1, max(a, b) + 1],
            scatter_m=float(scatter[a, b]),
        )


def _loosest(share: Floats) -> str:
    """Which marker to look at: the one without which the others are rigid."""
    m = len(share)
    rest = [float(np.nanmax(np.delete(np.delete(share, k, 0), k, 1))) for k in range(m)]
    k = int(np.argmin(rest))
    if m > 3 and rest[k] < 0.3 * float(np.nanmax(share)):
        return f"Without marker {k + 1} the others are: fasten it, or leave its columns out."
    return "Fasten them, or look for a marker taken for another."


def _scatter(distances: Floats) -> Floats:
    """Standard deviation (m, m) of each distance over the rows, by its median deviation: a few wild rows do not count."""
    return np.asarray(1.4826 * np.nan_to_num(_median(np.abs(distances - _median(distances)))))


def _is_odd(order: Order) -> bool:
    return bool(np.linalg.det(np.eye(len(order))[list(order)]) < 0)


FLAT = 0.01  # spread across the line of the markers, as a share of that along it, below which they lie in one line
NARROW = 0.1  # share of the largest triangle below which the first three markers do not set the frame
PASSES = 3


def marker_shape(markers: Floats, tip: Floats | None = None) -> Floats:
    """Common shape (m, 3) m of rigid marker sets (N, m, 3), in its own frame.

    Origin at the mean marker, z normal to the first three (or, where these are nearly in line, to the three that span
    most), x along the line from their middle to the first of them. The shape is the mean of all rows after a rigid
    alignment to each other (generalised Procrustes); rows with unseen markers count with those they show, so no row needs
    to show all. With ``tip (N, 3)``, a point of the tool digitised in some rows, the origin is that point.

    Raises:
        ObservationError: fewer than three markers, markers in one line, or markers that no row ties to the others.

    """
    if markers.shape[1] < 3:
        raise ObservationError(f"{markers.shape[1]} markers do not fix a pose: three or more, not in line, are needed.")
    shape = _assemble_shape(markers)
    for _ in range(PASSES):
        shape = _own_frame(_mean_of_rows(shape, markers))
    return shape if tip is None else shape - locate_tip(shape, markers, tip)


def locate_tip(shape: Floats, markers: Floats, tip: Floats) -> Floats:
    """Place (3,) m of a digitised point in the shape's frame: the mean over the rows that have it; zero where none has."""
    position, rotation, usable = fit_poses(shape, markers)
    rows = usable & ~np.isnan(tip).any(axis=1)
    if not rows.any():
        if np.isnan(tip).all():
            return np.zeros(3)
        raise ObservationError(
            "The tip was digitised in rows that do not show three markers: digitise it while they are seen."
        )
    return np.asarray(np.einsum("nji,nj->ni", rotation[rows], tip[rows] - position[rows]).mean(axis=0))


def fit_poses(shape: Floats, markers: Floats) -> tuple[Floats, Floats, Bools]:
    """Least-squares pose of the shape in every row (Kabsch 1976).

    Returns positions (N, 3) m of the shape's origin, rotations (N, 3, 3), and which rows show three markers or more that
    are not in one line.
    """
    rows = len(markers)
    position, rotation = np.full((rows, 3), np.nan), np.tile(np.eye(3), (rows, 1, 1))
    seen = np.asarray(~np.isnan(markers).any(axis=2)) & ~np.isnan(shape).any(axis=1)
    patterns, pattern = np.unique(seen, axis=0, return_inverse=True)
    usable = np.array([span_ratio(shape[p]) >= FLAT for p in patterns])[pattern.reshape(-1)]
    for k, p in enumerate(patterns):
        rows_of = np.flatnonzero((pattern.reshape(-1) == k) & usable)
        if len(rows_of):
            body, world = shape[p], markers[rows_of][:, p]
            b, w = body.mean(axis=0), world.mean(axis=1)
            rotation[rows_of] = _nearest_rotations((world - w[:, None]).transpose(0, 2, 1) @ (body - b))
            position[rows_of] = w - rotation[rows_of] @ b
    return position, rotation, usable


def _nearest_rotations(M: Floats) -> Floats:
    """:func:`~kilter_core.transforms.nearest_rotation` of many matrices (N, 3, 3) at once."""
    U, _, Vt = np.linalg.svd(M)
    U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    return np.asarray(U @ Vt)


def span_ratio(points: Floats) -> float:
    """How far points (k, 3) spread across their line, as a share of their spread along it; 0 for fewer than three."""
    if len(points) < 3:
        return 0.0
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(s[1] / s[0]) if s[0] > 0.0 else 0.0


def _assemble_shape(markers: Floats) -> Floats:
    """A first shape: the row that shows most, and the unseen markers from rows that share three others with it."""
    seen = np.asarray(~np.isnan(markers).any(axis=2))
    first = int(np.argmax(seen.sum(axis=1)))
    shape = markers[first].copy()
    if span_ratio(shape[seen[first]]) < FLAT:
        _refuse_line(markers, seen)
    while np.isnan(shape).any():
        known = int(np.isnan(shape).any(axis=1).sum())
        shape = _mean_of_rows(shape, markers)
        if int(np.isnan(shape).any(axis=1).sum()) == known:
            lost = [k + 1 for k in np.flatnonzero(np.isnan(shape).any(axis=1))]
            raise ObservationError(
                f"No row shows marker {lost[0]} together with three others that are known, so its place among them is "
                "not: measure one such row, or leave the marker out.",
                markers=lost,
            )
    return _own_frame(shape)


def _refuse_line(markers: Floats, seen: Bools) -> None:
    equal = np.argwhere(np.triu((markers[:, :, None] == markers[:, None]).all(axis=3).any(axis=0), 1))
    if len(equal):
        a, b = equal[0] + 1
        raise ObservationError(
            f"Markers {a} and {b} are equal to the last digit, and without one of them too few are left for a pose: their "
            "columns hold one marker twice. Correct the export or the column map.",
            code="markers_collinear",
        )
    if seen.sum(axis=1).max() < 3:
        raise ObservationError(
            "No row shows three markers, and no pose that was visited again does, so none fixes a pose: measure rows that do, "
            "visit the same poses with the reflector in each of three nests, or upload the points as x_mm, y_mm, z_mm with the "
            'nest as their session (session = { from = "nest" } in a column map, without [markers]) and give every session a '
            "tool point of its own (--refit tool)."
        )
    raise ObservationError(
        "The markers lie in one line: their rotation about it is unobservable. Add one off the line.",
        code="markers_collinear",
    )


def _mean_of_rows(shape: Floats, markers: Floats) -> Floats:
    """Mean (m, 3) of all rows in the shape's frame; NaN for a marker that no usable row shows."""
    position, rotation, usable = fit_poses(shape, markers)
    local = np.einsum("nji,nmj->nmi", rotation[usable], markers[usable] - position[usable, None])
    count = (~np.isnan(local)).sum(axis=0)
    total = np.nansum(local, axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _own_frame(points: Floats) -> Floats:
    if span_ratio(points) < FLAT:
        _refuse_line(points[None], np.ones((1, len(points)), dtype=bool))
    centred = points - points.mean(axis=0)
    a, b, c = _widest(centred)
    normal = np.cross(centred[b] - centred[a], centred[c] - centred[a])
    z = normal / np.linalg.norm(normal)
    # From the middle of the three, so that x lies in their plane wherever the others pull the origin.
    x = points[a] - points[[a, b, c]].mean(axis=0)
    x = x / np.linalg.norm(x)
    return np.asarray(centred @ np.stack([x, np.cross(z, x), z], axis=1))


def _widest(points: Floats) -> tuple[int, int, int]:
    """Three markers that set the frame: the first three unless others span far more."""

    threes = np.array(list(combinations(range(len(points)), 3)))
    a, b, c = points[threes.T]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    best = int(np.argmax(area))
    return tuple(threes[0 if area[0] >= NARROW * area[best] else best].tolist())
