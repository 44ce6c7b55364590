"""A part of a recording: between two times, or without some of its markers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from kilter_files.ground.errors import fault
from kilter_files.ground.names import did_you_mean
from kilter_files.tables.recording import Block, Recording


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
