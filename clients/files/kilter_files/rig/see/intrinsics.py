"""What the views say of the camera: its intrinsics, whether they were enough for them, or whether known ones fit.

Whether the views were enough for intrinsics: where the corners were, and how the board stood, apart from what is left.

A small residual says nothing of this: views of a board that always faces the camera leave little, with any focal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.match.rigid_body import rotations
from kilter_files.rig.see.optics.camera import Camera
from kilter_files.rig.see.optics.intrinsics_fit import LEAST_CORNERS, Fit, Seen, fit_intrinsics, median_view_rms
from kilter_files.rig.see.target import Target
from kilter_files.rig.see.views import View

MOST_KEPT = 150  # views; more teach a lens nothing
WORSE, ENOUGH_VIEWS = 1.5, 5  # times what the views' own intrinsics leave: they are another camera's
FLAT = 0.1  # of a square, beyond which corners were measured in another frame than the board's own
BAD_VIEW = 3.0  # times what the usual view leaves
MUCH_MORE, LEAST_SHOWN_PX = 4.0, 0.1  # left, by what the pictures' noise makes


@dataclass
class Kept:
    """Views kept for intrinsics: every one at first, then every second, so that there are never many."""

    views: list[Seen] = field(default_factory=list)
    _every: int = 1
    _offered: int = 0

    def offer(self, view: View, target: Target) -> None:
        """Keep a view, or not."""
        if self._offered % self._every == 0:
            self.views += _planes(view, target)
            if len(self.views) > 2 * MOST_KEPT:
                self.views, self._every = self.views[::2], 2 * self._every
        self._offered += 1

    def thinned_views(self) -> list[Seen]:
        """The views that are fitted, spread over all."""
        return self.views[:: 1 + len(self.views) // MOST_KEPT]


def _planes(view: View, target: Target) -> list[Seen]:
    """A view by its planes: each face of a cube is one."""
    found = []
    for face in range(len(target.faces)):
        own = target.on_face(face)
        known = [k for k, place in enumerate(view.places) if target.numbers[place] in own]
        if not known:
            continue
        mm = target.corners_mm[[view.places[k] for k in known]]
        if len(target.faces) > 1 or np.abs(mm[:, 2]).max() > FLAT * target.board.square_mm:
            mm = np.array([(*own[target.numbers[view.places[k]]], 0.0) for k in known])
        sigma = float(np.sqrt((view.sigmas[known] ** 2).mean()))
        found.append(Seen(view.picture, mm, view.pixels[known], sigma))
    return found


def fit_camera_with_report(
    kept: Kept, size: tuple[int, int], model: str, name: str
) -> tuple[Camera, dict[str, Any], list[str]]:
    """Return the camera, the report of its fit, and warnings.

    Raises:
        FileError: too few views, or none that a camera explains.

    """
    views = kept.thinned_views()
    fit = fit_intrinsics(views, size, model, name)
    gates = evaluate_gates(views, fit)
    missing = [gate for gate in gates if not gate.met]
    warnings = [
        f"intrinsics are not to be trusted, whatever they leave: {gate.name} is {gate.value:.3g}, needed {gate.needed:g}. "
        + gate.remedy.rstrip(".")
        for gate in missing
    ]
    rms = fit.view_rms_px
    usual = float(sorted(rms)[len(rms) // 2])
    bad = [name for name, own in zip(fit.pictures, rms, strict=True) if own > BAD_VIEW * usual]
    if bad:
        warnings.append(f"{len(bad)} views leave more than {BAD_VIEW:g} times the usual: {', '.join(bad[:3])}")
    sigma = float(np.median([view.sigma_px for view in views]))
    if fit.rms_px > max(MUCH_MORE * sigma, LEAST_SHOWN_PX):
        warnings.append(
            f"{fit.rms_px:.2f} px are left, and the pictures' noise makes {sigma:.2f}: "
            "the board is not flat, its squares are not as stated, or the lens needs another model"
        )
    report = {
        "model": model,
        "views": len(rms),
        "rms_px": round(fit.rms_px, 4),
        "largest_view_rms_px": round(float(rms.max()), 4),
        "sigma_px": round(sigma, 4),
        "corners_left_out": fit.left_out,
        "gates": [gate.to_document() for gate in gates],
        "trusted": not missing,
    }
    return replace(fit.camera, known="free" if missing else "prior"), report, warnings


def check_known(kept: Kept, camera: Camera) -> list[str]:
    """Warn where known intrinsics do not fit the views."""
    views = kept.thinned_views()
    left = median_view_rms(views, camera)
    if left is None or left < LEAST_SHOWN_PX or sum(len(view.pixels) >= LEAST_CORNERS for view in views) < ENOUGH_VIEWS:
        return []
    lens = "brown" if camera.distortion_model == "none" else camera.distortion_model
    own = float(np.median(fit_intrinsics(views, camera.size, lens, camera.name).view_rms_px))
    if left < WORSE * own + LEAST_SHOWN_PX:
        return []
    what = f"the intrinsics leave {left:.2f} px in the usual view, and those of the views themselves {own:.2f}"
    return [
        f"{what}: they are of another camera or zoom, unless the board is (kilter measure see --intrinsics brown "
        "finds them anew)"
    ]


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
