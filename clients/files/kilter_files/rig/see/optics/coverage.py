"""Whether the views were enough for intrinsics: where the corners were, and how the board stood, apart from what is left.

A small residual says nothing of this: views of a board that always faces the camera leave little, with any focal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.match.arm import rotations
from kilter_files.rig.see.optics.intrinsics_fit import Fit, Seen

CELLS = (5, 4)  # across and down
TILT_DEG = 12.0
FEW_CORNERS = 12


@dataclass(frozen=True)
class Gate:
    """One condition: what was found and what is needed."""

    name: str
    value: float
    needed: float
    remedy: str

    @property
    def met(self) -> bool:
        """Whether it is enough."""
        return self.value >= self.needed

    def to_document(self) -> dict[str, object]:
        """Return the gate as the JSON file holds it."""
        return {"name": self.name, "value": round(self.value, 3), "needed": self.needed, "met": self.met}


def evaluate_gates(seen: Sequence[Seen], fit: Fit) -> list[Gate]:
    """Return all gates: of the views, of the corners in the picture, and of the poses."""
    camera = fit.camera
    pixels = np.concatenate([view.pixels for view in seen])
    full = sum(len(view.pixels) >= FEW_CORNERS for view in seen)
    tilts = _tilts(fit.poses)
    return [
        Gate("views", full, 10, f"Take at least 10 pictures with {FEW_CORNERS} corners and more."),
        Gate(
            "cells", _cells(pixels, camera.size), 0.7, "Move the board into the parts of the picture not yet covered."
        ),
        Gate("edge", _edge(pixels, camera.size), 0.75, "Move the board into the picture's corners."),
        Gate("tilts", _both_ways(tilts), 2, f"Tilt the board by more than {TILT_DEG:g} deg, about both of its axes."),
        Gate("distances", _distances(fit.poses), 1.15, "Take pictures from nearer and from farther away."),
    ]


def _cells(pixels: Floats, size: tuple[int, int]) -> float:
    """Part of the cells of the picture that have a corner."""
    cells = np.clip(((pixels + 0.5) / size * CELLS).astype(int), 0, np.subtract(CELLS, 1))
    return len({tuple(cell) for cell in cells.tolist()}) / (CELLS[0] * CELLS[1])


def _edge(pixels: Floats, size: tuple[int, int]) -> float:
    """How far out corners were: the 99th percentile of distances from the middle, in halves of the diagonal."""
    off = pixels - (np.array(size) - 1) / 2
    return float(np.percentile(np.linalg.norm(off, axis=1), 99) / (np.linalg.norm(size) / 2))


def _tilts(poses: Floats) -> Floats:
    """Where the boards' normals point (views, 2): the sine of the angle to the line of sight, across and down."""
    return rotations(poses[:, :3])[:, :2, 2]


def _both_ways(tilts: Floats) -> float:
    """The smaller of the counts of views tilted about one axis and about the other."""
    least = np.sin(np.radians(TILT_DEG))
    return float((np.abs(tilts) >= least).sum(axis=0).min())


def _distances(poses: Floats) -> float:
    """The farthest distance by the nearest."""
    return float(poses[:, 5].max() / max(1e-9, poses[:, 5].min()))
