"""What devices write for a marker that was not seen, turned into NaN. A gap is never a coordinate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kilter_files.ground.arrays import Floats
from kilter_files.ground.later import np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Optotrak writes -3.697e28 (bytes EE EE EE EE); nothing that is measured in mm comes near
BEYOND_MM = 1e12


def without_gaps(points: Floats, residual: NDArray[np.floating] | None = None) -> Floats:
    """Return ``points`` (n, markers, 3) with every marker that was not seen NaN in all three coordinates.

    Not seen is: not finite, beyond any length, all zero, or a negative residual.
    """
    with np.errstate(invalid="ignore"):
        seen = (np.abs(points) < BEYOND_MM).all(axis=-1) & (points != 0.0).any(axis=-1)
        if residual is not None:
            seen &= ~(residual < 0)
    if not seen.all():
        points[~seen] = np.nan
    return points


def unit_quaternions(turned: Floats, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return ``turned`` (n, markers, 4) at unit length, NaN where nothing was seen, and which were not a rotation."""
    seen = ~np.isnan(points[..., 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.sqrt((turned * turned).sum(axis=-1))
        wrong = seen & ~(np.abs(size - 1.0) < 0.02)
        turned = turned / size[..., None]
    turned[~seen] = np.nan
    return turned, wrong
