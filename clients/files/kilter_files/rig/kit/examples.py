"""Poses to photograph: within the limits, near those that are there, and such that the camera sees the board."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from kilter_files.ground.arrays import Bools, Floats
from kilter_files.ground.later import np
from kilter_files.rig.kit.moments import flange
from kilter_files.rig.kit.sight import Sight

OFF_STOPS = 0.03  # of a joint's range
MOST_EXAMPLES, APART_DEG = 3, 30.0
STEPS_OF_A_JOINT = 13  # of the poses among which an example is sought
WAYS_TO_SHOW = 13  # of the first joint and of the last, which rotate the board and change no load
LEAST_SHOWN = 0.1  # of the score of a board that faces the camera in the middle of the picture

Limits = Sequence[tuple[float, float] | None]
Examples = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Sought:
    """Where examples are sought: poses ``seen`` (N, n), deg, of an arm with ``limits``; ``find`` finds what its cameras see.

    The first joint and the last are rotated until the board is seen; the others stand on a grid.
    """

    chain: Mapping[str, Any]
    seen: Floats
    limits: Limits
    find: Callable[[], Sequence[Sight]] = tuple

    @cached_property
    def sights(self) -> Sequence[Sight]:
        """Cameras and boards where views tell where they stand: found when somebody looks for examples."""
        return self.find()

    @property
    def inner(self) -> list[int]:
        """Joints, from 0, between the first and the last."""
        return [*range(1, self.seen.shape[1] - 1)]

    @property
    def grid_poses(self) -> Floats:
        """Poses (M, n) of the grid, first and last joint as in the nearest of those seen."""
        return self._grid[0]

    @cached_property
    def _grid(self) -> tuple[Floats, Floats]:
        """Poses (M, n), and how far (M,) each is from those seen, deg."""
        grid = np.array(list(itertools.product(*(self._steps(k, STEPS_OF_A_JOINT) for k in self.inner))))
        poses = np.unique(self.seen, axis=0)
        away = np.stack([np.max(np.abs(grid - pose[self.inner]), axis=1) for pose in poses])
        tried = poses[np.argmin(away, axis=0)]
        tried[:, self.inner] = grid
        return tried, away.min(axis=0)

    def nearest(self, fits: Bools) -> tuple[Examples, bool | None]:
        """Those of the grid that fit (M,), the nearest first and apart, and whether the board is seen there.

        None where nothing says so or none fits, False where it is seen at none that fits.
        """
        found = self._cheapest_distinct_poses(
            np.where(fits, self._grid[1], np.inf), self._steps(0, WAYS_TO_SHOW), self._last_joint_steps()
        )
        return found, (bool(found) if self.sights and fits.any() else None)

    def beyond(self, joint: int, below: float, above: float) -> tuple[Examples, bool | None]:
        """Poses with a joint, from 0, at ``below`` or less or ``above`` or more, as :meth:`nearest`."""
        if joint in self.inner:
            return self.nearest((self.grid_poses[:, joint] <= below) | (self.grid_poses[:, joint] >= above))
        ways = [self._steps(0, WAYS_TO_SHOW), self._last_joint_steps()]
        own = ways[0 if joint == 0 else 1]
        ways[0 if joint == 0 else 1] = own = own[(own <= below) | (own >= above)]
        if not len(own):
            return (), None
        found = self._cheapest_distinct_poses(self._grid[1], *ways) if self.sights else ()
        return found, (bool(found) if self.sights else None)

    def _cheapest_distinct_poses(self, cost: Floats, pans: Floats, rolls: Floats) -> Examples:
        """The cheapest of the grid whose inner joints are apart and that show the board; those of infinite cost never."""
        chosen, left, inner = list[tuple[float, ...]](), cost.copy(), self.grid_poses[:, self.inner]
        ways = self._ways(pans, rolls) if self.sights else None
        while len(chosen) < MOST_EXAMPLES and np.isfinite(left).any():
            k = int(np.argmin(left))
            pose = self.grid_poses[k].copy()
            if ways is not None:
                score = self._score(pose, *ways)
                a, b = np.unravel_index(np.argmax(score), score.shape)
                pose[0], pose[-1] = pans[a], rolls[b]
                if score[a, b] <= LEAST_SHOWN:
                    left[k] = np.inf
                    continue
            chosen.append(tuple(round(float(value), 1) for value in pose))
            left[np.max(np.abs(inner - inner[k]), axis=1) < APART_DEG] = np.inf
        return tuple(chosen)

    def _ways(self, pans: Floats, rolls: Floats) -> tuple[Floats, Floats]:
        """What the first joint puts before the pose of an arm with it and the last at zero, and the last one behind."""
        at_zero = np.linalg.inv(self._flanges(0, np.zeros(1))[0])
        return self._flanges(0, pans) @ at_zero, at_zero @ self._flanges(self.seen.shape[1] - 1, rolls)

    def _flanges(self, joint: int, readings: Floats) -> Floats:
        """Poses (N, 4, 4) of the flange with one joint at readings (N,), deg, and all others at zero."""
        q = np.zeros((len(readings), self.seen.shape[1]))
        q[:, joint] = readings
        return flange(self.chain, q)

    def _score(self, pose: Floats, before: Floats, after: Floats) -> Floats:
        straight = pose.copy()
        straight[[0, -1]] = 0.0
        own = flange(self.chain, straight[None])[0]
        return np.asarray(np.max([one.score(before[:, None] @ (own @ after)) for one in self.sights], axis=0))

    def _last_joint_steps(self) -> Floats:
        return self._steps(self.seen.shape[1] - 1, WAYS_TO_SHOW)

    def _steps(self, k: int, steps: int) -> Floats:
        low, high = self.limits[k] or (-180.0, 180.0)
        off = OFF_STOPS * (high - low)
        return np.linspace(low + off, high - off, steps)


def format_examples(examples_deg: Examples) -> str:
    """Poses as a sentence names them."""
    return " or ".join(f"({', '.join(f'{value:.0f}' for value in one)})" for one in examples_deg) + " deg"
