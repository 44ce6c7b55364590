"""A second detector for AprilTags: the AprilTag library itself, whose corners are compared with our own."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import UsageError
from kilter_files.ground.later import need
from kilter_files.rig.see.pictures import Grey, Refusal
from kilter_files.rig.see.target import Target
from kilter_files.rig.see.views import View

FAMILIES = {"apriltag_36h11": "tag36h11", "apriltag_25h9": "tag25h9", "apriltag_16h5": "tag16h5"}
CENTRE = 0.5  # where it puts the centre of the upper left pixel
MOST_APART_PX, MOST_BIAS_PX = 1.0, 0.05
SAME_TAG_PX = 8.0
PACKAGE = "pupil-apriltags"


@dataclass
class Second:
    """Compares views of AprilTag boards: sums over all corners that both detectors found."""

    family: str
    corners: int = 0
    views: int = 0
    _sum: Floats = field(default_factory=lambda: np.zeros(2))
    _squares: Floats = field(default_factory=lambda: np.zeros(2))
    _detector: Any = None

    def compare(self, grey: Grey, view: View, target: Target) -> Refusal | None:
        """Compare a view's corners; a refusal where one is far from where the other detector sees it."""
        numbers = [target.numbers[place] for place in view.places]
        others = self._detect_tags(grey)
        off, known = [], []
        for number, place in zip(numbers, view.pixels, strict=True):
            quad = others.get(number // 4)
            if quad is None:
                continue
            apart = quad - place
            nearest = apart[np.linalg.norm(apart, axis=1).argmin()]
            if np.linalg.norm(nearest) < SAME_TAG_PX:
                off.append(-nearest)
                known.append(number)
        if not off:
            return None
        all_off = np.array(off)
        worst = int(np.linalg.norm(all_off, axis=1).argmax())
        if np.linalg.norm(all_off[worst]) > MOST_APART_PX:
            what = f"the two detectors put it {np.linalg.norm(all_off[worst]):.1f} px apart"
            return Refusal(view.picture, "detectors_differ", what, known[worst], target.name)
        self.views += 1
        self.corners += len(off)
        self._sum += all_off.sum(axis=0)
        self._squares += (all_off**2).sum(axis=0)
        return None

    def _detect_tags(self, grey: Grey) -> dict[int, Floats]:
        """Quads (4, 2) px by the number of the tag, in our convention."""
        if self._detector is None:
            self._detector = _detector(self.family)
        return {int(tag.tag_id): np.asarray(tag.corners) - CENTRE for tag in self._detector.detect(grey)}

    def bias_px(self) -> float:
        """How far the corners are apart on average, by direction."""
        return float(np.linalg.norm(self._sum) / max(1, self.corners))

    def to_document(self) -> dict[str, Any]:
        """Return what came of it: ours minus theirs."""
        count = max(1, self.corners)
        mean = self._sum / count
        return {
            "detector": PACKAGE,
            "views": self.views,
            "corners": self.corners,
            "mean_u_px": round(float(mean[0]), 4),
            "mean_v_px": round(float(mean[1]), 4),
            "rms_px": round(float(np.sqrt(self._squares.sum() / (2 * count))), 4),
        }


def create_second_detector(targets: list[Target]) -> Second:
    """Return the second detector for these boards.

    Raises:
        UsageError: boards without AprilTags, of several families, or of one that it does not know.
        MissingPackageError: it is not installed.

    """
    names = {target.board.dictionary for target in targets if target.board.kind == "apriltag"}
    if len(names) != 1 or not names <= set(FAMILIES):
        raise UsageError(f"--cross-check: is for AprilTag boards of one dictionary: {', '.join(FAMILIES)}.")
    second = Second(FAMILIES[names.pop()])
    second._detector = _detector(second.family)
    return second


@cache
def _detector(family: str) -> Any:
    """The detector of a family, one for the whole process: its own way to destroy itself frees the family's memory twice."""
    pupil_apriltags = need("The second detector needs", PACKAGE, "pupil_apriltags")
    kind = type("Kept", (pupil_apriltags.Detector,), {"__del__": lambda _: None})
    # smaller pictures (quad_decimate above 1) would shift its corners
    return kind(families=family, nthreads=2, quad_decimate=1.0, refine_edges=1)
