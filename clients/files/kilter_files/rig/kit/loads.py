"""Which way gravity pulls each joint over the views: where it is always the same way, backlash and zero are one number."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from kilter_files.ground.arrays import Bools, Floats
from kilter_files.ground.later import np
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


G_M_S2 = (0.0, 0.0, -9.80665)


def gravity_moments(chain: Mapping[str, Any], q_deg: Floats, payload_kg: Floats) -> Floats | None:
    """Moments (N, n), N m, about the joints in their directions, at readings (N, n), with masses (N,) at the tool point.

    ``chain`` is a robot document of convention ``chain``. None where it states no masses, has a prismatic joint, or one
    that drives several axes. The numbers are nominal: which way a load pulls is meant, and roughly how much.
    """
    links, names = chain.get("links"), [joint["name"] for joint in chain["joints"]]
    driven = [one for one in chain["elements"] if one.get("joint")]
    if not links or [one["joint"] for one in driven] != names or any(one["axis"][0] == "T" for one in driven):
        return None
    frames, tool = _frames(chain["elements"], q_deg, names), chain.get("tool") or {}
    gravity = np.array(chain.get("gravity_m_s2") or G_M_S2, dtype=float)
    held = (
        _points_in_base(frames[-1], [float(tool.get(f"{axis}_mm") or 0.0) for axis in "xyz"]),
        payload_kg[:, None] * gravity,
    )
    hung = [
        (_points_in_base(frame, link.get("com_mm") or [0.0, 0.0, 0.0]), float(link.get("mass_kg") or 0.0) * gravity)
        for frame, link in zip(frames, links, strict=False)
    ]
    told = []
    for j, (frame, one) in enumerate(zip(frames, driven, strict=False)):
        axis = math.copysign(1.0, one.get("ratio") or 1.0) * frame[:, :3, "xyz".index(one["axis"][1])]
        moment = sum(np.cross(centre - frame[:, :3, 3], weight) for centre, weight in [*hung[j:], held])
        told.append(1e-3 * np.einsum("ni,ni->n", axis, moment))
    return np.column_stack(told)


def flange(chain: Mapping[str, Any], q_deg: Floats) -> Floats:
    """Frames (N, 4, 4) of the flange in the base, mm, at readings (N, n) of an arm that is as its document says."""
    return _frames(chain["elements"], q_deg, [joint["name"] for joint in chain["joints"]])[-1]


def _frames(elements: Sequence[Mapping[str, Any]], q_deg: Floats, names: Sequence[str]) -> list[Floats]:
    """Frames (N, 4, 4) right after each joint, and last that of the flange; lengths in mm."""
    T, frames = np.tile(np.eye(4), (len(q_deg), 1, 1)), []
    for one in elements:
        joint = one.get("joint")
        turned = float(one.get("ratio") or 1.0) * q_deg[:, names.index(joint)] if joint else np.zeros(len(q_deg))
        T = T @ _step(one["axis"], float(one.get("value") or 0.0) + turned)
        if joint:
            frames.append(T)
    return [*frames, T]


def _points_in_base(frame: Floats, point_mm: Sequence[float]) -> Floats:
    """A point (N, 3), mm, that stands still in frames (N, 4, 4)."""
    placed: Floats = frame[:, :3, :3] @ np.array(point_mm, dtype=float) + frame[:, :3, 3]
    return placed


def _step(axis: str, value: Floats) -> Floats:
    """Elementary transforms (N, 4, 4): ``Tx`` in mm along an axis, ``Rx`` in degrees about it."""
    T = np.tile(np.eye(4), (len(value), 1, 1))
    k = "xyz".index(axis[1])
    if axis[0] == "T":
        T[:, k, 3] = value
        return T
    c, s = np.cos(np.radians(value)), np.sin(np.radians(value))
    i, j = (k + 1) % 3, (k + 2) % 3
    T[:, i, i], T[:, j, j], T[:, i, j], T[:, j, i] = c, c, -s, s
    return T


LEAST_LOAD_NM = 0.05  # well beyond the friction of a servo: it rests on one flank then
FEWEST_EITHER_WAY = 6  # views
CLEARLY = 0.5  # of the most that gravity can pull so: whoever comes near an example still has the other way


@dataclass(frozen=True)
class Pulled:
    """How many views gravity pulls a joint the one way, and the other; ``wanted`` more of the fewer.

    ``examples_deg`` are readings at which it pulls the fewer way, those near views that are there first; none where none is
    within the limits, or none is wanted. ``shown`` says whether the camera sees the board there; None where the views do not
    say where camera and board stand.
    """

    joint: int
    name: str
    views: int
    more: int
    fewer: int
    wanted: int
    examples_deg: Examples
    shown: bool | None = None

    @property
    def missing(self) -> str | None:
        """What to photograph; None where nothing is missing, or the arm cannot."""
        if not self.examples_deg:
            return None
        sees = (
            "where the camera sees the board"
            if self.shown
            else "rotating the first and the last joint until the camera sees the board: these views do not say where it stands"
        )
        return (
            f"views in which gravity pulls joint {self.joint} ({self.name}) the other way: it does in {self.fewer} of "
            f"{self.views}, take {self.wanted} more, for example near {format_examples(self.examples_deg)}, {sees}"
        )

    @property
    def untold(self) -> str | None:
        """Why backlash of this joint cannot be told; None where it can."""
        if not self.wanted:
            return None
        cannot = "" if self.examples_deg else ", and within the limits of the joints no pose changes that"
        if self.shown is False:
            cannot = (
                ", and at no pose that changes that does the camera see the board: move the camera, or fix the board to "
                "another side of the gripper, and take all views anew"
            )
        return (
            f"the backlash of joint {self.joint} ({self.name}) cannot be told from its zero: gravity pulls it the other way "
            f"in {self.fewer} of {self.views} views only{cannot}"
        )


def gravity_loaded_joints(joints: int) -> range:
    """Joints, from 1, that gravity loads: the first is vertical, the last carries no moment about itself."""
    return range(2, joints)


def count_gravity_directions(sought: Sought, payloads_kg: Sequence[float]) -> list[Pulled]:
    """Count the views by the way in which gravity pulls each joint; nothing where the chain does not tell its loads.

    The views are those ``sought.seen`` (N, n), with ``payloads_kg`` (N,). Examples are poses at which one of its sights shows
    the board, where there are any.
    """
    q = sought.seen
    moments = gravity_moments(sought.chain, q, np.array(payloads_kg, dtype=float))
    if moments is None:
        return []
    lacking, found = dict[int, float](), []
    for joint in gravity_loaded_joints(q.shape[1]):
        up = int(np.sum(moments[:, joint - 1] > LEAST_LOAD_NM))
        down = int(np.sum(moments[:, joint - 1] < -LEAST_LOAD_NM))
        wanted = max(0, FEWEST_EITHER_WAY - min(up, down))
        if wanted:
            lacking[joint] = 1.0 if up < down else -1.0
        name = str(sought.chain["joints"][joint - 1]["name"])
        found.append((joint, name, len(q), max(up, down), min(up, down), wanted))
    examples = _examples(sought, sorted(set(payloads_kg)), lacking) if lacking else {}
    return [Pulled(*one, *examples.get(one[0], ((), None))) for one in found]


def _examples(
    sought: Sought, payloads: Sequence[float], lacking: Mapping[int, float]
) -> dict[int, tuple[Examples, bool | None]]:
    """For each joint poses at which gravity pulls it the way that is lacking, and whether the board is seen there."""
    ends, tried = sorted({payloads[0], payloads[-1]}), sought.grid_poses
    moments = [gravity_moments(sought.chain, tried, np.full(len(tried), kg)) for kg in ends]
    return {
        joint: sought.nearest(_pulls([sign * one[:, joint - 1] for one in moments if one is not None]))
        for joint, sign in lacking.items()
    }


def _pulls(each: Sequence[Floats]) -> Bools:
    """Where gravity pulls clearly, with any payload if it can, else with one of them."""
    weakest, strongest = np.min(each, axis=0), np.max(each, axis=0)
    pull = weakest if weakest.max() > LEAST_LOAD_NM else strongest
    return np.asarray(pull > max(CLEARLY * float(pull.max()), LEAST_LOAD_NM))
