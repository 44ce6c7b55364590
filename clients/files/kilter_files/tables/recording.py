"""A part of a recording: between two times, or without some of its markers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import did_you_mean, fault
from kilter_files.ground.later import np
from kilter_files.ground.units import SIZES

if TYPE_CHECKING:
    from numpy.typing import NDArray


def cut_to_interval(recording: Recording, since_s: float, until_s: float) -> Recording:
    """Return the frames from ``since_s`` to ``until_s``, which keep their times.

    Raises:
        FileError: no frame lies there.

    """
    if not np.isfinite([since_s, until_s]).any():
        return recording
    first = max(0, int(np.ceil(since_s * recording.rate_hz))) if np.isfinite(since_s) else 0
    last = min(recording.frames - 1, int(until_s * recording.rate_hz)) if np.isfinite(until_s) else recording.frames - 1
    if last - first < 2:
        what = f"has no frames from {max(since_s, 0):g} to {min(until_s, recording.duration_s):g} s"
        raise fault(recording.path, what, f"It lasts {recording.duration_s:.2f} s; give other times.")

    def blocks() -> Iterator[Block]:
        for block in recording.blocks():
            inside = (block.t_s >= since_s) & (block.t_s <= until_s)
            if inside.any():
                turned = None if block.quaternions is None else block.quaternions[inside]
                yield Block(block.t_s[inside], block.points_mm[inside], block.rows[inside], turned)

    return replace(recording, frames=last - first + 1, blocks=blocks)


def drop_markers(recording: Recording, names: Sequence[str]) -> Recording:
    """Return a recording without the markers of these names; the others are numbered anew.

    Raises:
        FileError: there is no such marker, or none is left.

    """
    for name in names:
        if name not in recording.markers:
            what = f"has no marker {name!r}{did_you_mean(name, recording.markers)}"
            raise fault(recording.path, what, f"It has {', '.join(recording.markers)}.")
    kept = [k for k, name in enumerate(recording.markers) if name not in names]
    if not kept:
        raise fault(recording.path, "no marker is left", "Leave out fewer.")

    def blocks() -> Iterator[Block]:
        for block in recording.blocks():
            turned = None if block.quaternions is None else block.quaternions[:, kept]
            yield replace(block, points_mm=block.points_mm[:, kept], quaternions=turned)

    return replace(recording, markers=tuple(recording.markers[k] for k in kept), blocks=blocks)


BLOCK_BYTES = 8 << 20


@dataclass(frozen=True)
class Block:
    """Consecutive frames: ``points_mm`` (n, markers, 3) and ``quaternions`` (n, markers, 4; w first), NaN = not seen.

    ``rows`` are the lines of a text file, else the numbers of the frames, counted from 1.
    """

    t_s: Floats
    points_mm: Floats
    rows: NDArray[np.int64]
    quaternions: Floats | None = None

    def __len__(self) -> int:
        return len(self.t_s)


@dataclass(frozen=True)
class Recording:
    """What a file of markers says of itself, and its frames; every call of ``blocks`` reads them from the start."""

    path: Path
    kind: str
    markers: tuple[str, ...]
    rate_hz: float
    frames: int
    blocks: Callable[[], Iterator[Block]]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unit: str = "mm"  # that the file states or is taken to be in; the blocks are in mm

    @property
    def duration_s(self) -> float:
        """The time from the first frame to the last."""
        return max(0, self.frames - 1) / self.rate_hz

    def whole(self) -> Block:
        """Return all frames at once, for recordings known to be short."""
        parts = list(self.blocks())
        turned = [part.quaternions for part in parts if part.quaternions is not None]
        return Block(
            np.concatenate([part.t_s for part in parts]),
            np.concatenate([part.points_mm for part in parts]),
            np.concatenate([part.rows for part in parts]),
            np.concatenate(turned) if len(turned) == len(parts) else None,
        )


def in_stated_unit(recording: Recording, unit: str | None) -> Recording:
    """Return a recording whose coordinates are in ``unit``, whatever the file states; None: as it states."""
    return recording if unit is None else in_unit(recording, unit)


def in_unit(recording: Recording, unit: str) -> Recording:
    """Read the coordinates in ``unit``, whatever the file states.

    Raises:
        FileError: it is not a unit of length.

    """
    if unit not in SIZES["length"]:
        raise fault(recording.path, f"{unit!r} is not a unit of length", f"Give one of {', '.join(SIZES['length'])}.")
    if unit == recording.unit:
        return recording
    factor = SIZES["length"][unit] / SIZES["length"][recording.unit]

    def blocks() -> Iterator[Block]:
        for block in recording.blocks():
            yield replace(block, points_mm=block.points_mm * factor)

    said = f"coordinates taken as {unit}, as you say; the file says {recording.unit}"
    return replace(recording, blocks=blocks, unit=unit, warnings=(*recording.warnings, said))


def frames_per_block(markers: int) -> int:
    """Return how many frames of so many markers make a block."""
    return max(256, BLOCK_BYTES // (24 * max(1, markers)))


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
