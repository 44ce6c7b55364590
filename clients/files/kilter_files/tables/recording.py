"""A recording of markers: frames at a rate, read block by block so that its length does not matter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.ground.later import np
from kilter_files.ground.units import SIZES

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
