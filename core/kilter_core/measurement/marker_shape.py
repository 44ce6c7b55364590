"""Poses from three or more markers on the tool: the shape they share, and its rigid fit to each row."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.types import Bools, Floats

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
