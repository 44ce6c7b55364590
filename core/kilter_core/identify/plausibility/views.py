"""Whether views belong to their joint readings: against shuffled rows and reversed joints, by hand-eye alone.

A hand-eye calibration of the nominal arm leaves millimetres. Rows whose joints belong to other pictures leave what any
shuffled rows do, and a joint that is read with the other sign leaves far more than it does reversed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.measurement import Measurement
from kilter_core.measurement.board_poses import board_poses
from kilter_core.measurement.hand_eye import solve_axzb
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.transforms import inverses
from kilter_core.types import Floats

MOST_VIEWS = 60
FEWEST_VIEWS = 8
SHUFFLES = 5
UNRELATED = 0.5  # of what shuffled rows leave, beyond which the rows say no more than those
BETTER = 0.4  # of what the rows leave as given, below which a reversed joint is the truth
AS_GOOD = 1.25  # times that: then nothing tells the senses apart
ARM_M = 0.3  # what a radian left is worth


@dataclass(frozen=True)
class _Sample:
    """Views that tell a pose, of one camera and one board."""

    begin: Calibration
    rows: Observations
    position: Floats
    rotation: Floats

    def shuffled(self) -> float:
        """What hand-eye leaves (m) where the joints belong to other rows: the median of some shuffles."""
        rng, q = np.random.default_rng(0), self.rows.q
        return float(np.median([self.left(q[rng.permutation(len(q))]) for _ in range(SHUFFLES)]))

    def left(self, q: Floats) -> float:
        """What hand-eye leaves (m, median) with these joint readings; inf where it tells nothing."""
        found = self.begin.predict(replace(self.rows, q=q))
        try:
            solved = solve_axzb(found.position, found.rotation, self.position, self.rotation)
        except ObservationError:
            return np.inf
        return float(np.median(solved.left_m) + ARM_M * np.median(solved.left_rad))


def refuse_unrelated_views(begin: Calibration, rows: Observations) -> tuple[dict[str, Any], ...]:
    """Refuse views whose joints are of other pictures or read the other way round; warn of senses that fit as well.

    Raises:
        ObservationError: ``foreign_observations``.

    """
    sample = _sample(begin, rows)
    if sample is None:
        return ()
    q = sample.rows.q
    given = sample.left(q)
    shuffled = sample.shuffled()
    reversed_ = {j: sample.left(np.where(np.arange(q.shape[1]) == j, -q, q)) for j in range(q.shape[1])}
    best = min(reversed_, key=lambda j: (reversed_[j], j))
    name = begin.robot.joints[best].name
    if reversed_[best] < BETTER * given and reversed_[best] < UNRELATED * shuffled:
        raise ObservationError(
            f"With the readings of joint {name} reversed, camera and arm agree to {mm(reversed_[best]):.3g} mm, as given to "
            f"{mm(given):.3g} mm: it seems to be read with the opposite sign. Reverse its column, or correct the robot.",
            code="foreign_observations",
            joint=name,
        )
    if given > UNRELATED * shuffled:
        raise ObservationError(
            f"Camera and arm agree to {mm(given):.3g} mm, shuffled rows to {mm(shuffled):.3g} mm: the joint readings do "
            "not belong to the pictures. Join them by their times again; check that robot, mounts and board are right.",
            code="foreign_observations",
            shuffled_mm=mm(shuffled),
        )
    return tuple(_alike(sample, reversed_, given))


def shuffled_control(begin: Calibration, rows: Observations) -> dict[str, float | None]:
    """The negative control of views: what hand-eye leaves with the joints as given, and with those of other rows.

    Both are None where too few views tell a pose, or hand-eye finds nothing.
    """
    sample = _sample(begin, rows)
    left = (np.inf, np.inf) if sample is None else (sample.left(sample.rows.q), sample.shuffled())
    given, shuffled = (mm(one) if np.isfinite(one) else None for one in left)
    return {"given_mm": given, "shuffled_mm": shuffled}


def _alike(sample: _Sample, reversed_: dict[int, float], given: float) -> Iterator[dict[str, Any]]:
    """Say which joints fit as well reversed: no view tells in which sense they move."""
    for j, left in reversed_.items():
        if left < AS_GOOD * given and np.ptp(sample.rows.q[:, j]) > 0.1:
            name = sample.begin.robot.joints[j].name
            yield {
                "code": "mirrored_sense", "joint": name,
                "message": f"Joint {name} fits these pictures as well with the opposite sense: camera and board would stand "
                "elsewhere. Add views in which further joints move, or move that joint alone and see which way the board goes.",
            }  # fmt: skip


def _sample(begin: Calibration, rows: Observations) -> _Sample | None:
    views = Measurement.of(rows, begin.marker_points, held=True).pixels
    if views is None or rows.camera is None or rows.board is None:
        return None
    pairs = np.stack([rows.camera, rows.board], axis=1)
    seen = pairs[(rows.camera >= 0) & views.measured()]
    if not len(seen):
        return None
    kinds, count = np.unique(seen, axis=0, return_counts=True)
    c, b = (int(k) for k in kinds[int(np.argmax(count))])
    which = np.flatnonzero((rows.camera == c) & (rows.board == b) & views.measured())
    which = which[:: max(1, -(-len(which) // MOST_VIEWS))]
    camera, board = views.rig.cameras[c], views.rig.boards[b]
    pixels = views.pixels[which][:, : len(board.corners)]
    p, R, _, usable = board_poses(camera, np.array(camera.values), board, pixels)
    if usable.sum() < FEWEST_VIEWS:
        return None
    p, R = p[usable], R[usable]
    if camera.mount == "flange":
        p, R = inverses(p, R)
    return _Sample(begin, rows.select(which[usable]), p, R)
