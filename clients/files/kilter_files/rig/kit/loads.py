"""Which way gravity pulls each joint over the views: where it is always the same way, backlash and zero are one number."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kilter_files.ground.arrays import Bools, Floats
from kilter_files.ground.later import np
from kilter_files.rig.kit.moments import flange, gravity_moments
from kilter_files.rig.kit.sight import Sight

LEAST_LOAD_NM = 0.05  # well beyond the friction of a servo: it rests on one flank then
FEWEST_EITHER_WAY = 6  # views
CLEARLY = 0.5  # of the most that gravity can pull so: whoever comes near an example still has the other way
OFF_STOPS = 0.03  # of a joint's range
MOST_EXAMPLES, APART_DEG = 3, 30.0
STEPS_OF_A_JOINT = 13  # of the poses among which an example is sought
WAYS_TO_SHOW = 13  # of the first joint and of the last, which rotate the board and change no load
LEAST_SHOWN = 0.1  # of the score of a board that faces the camera in the middle of the picture


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
    examples_deg: tuple[tuple[float, ...], ...]
    shown: bool | None = None

    @property
    def missing(self) -> str | None:
        """What to photograph; None where nothing is missing, or the arm cannot."""
        if not self.examples_deg:
            return None
        near = " or ".join(f"({', '.join(f'{value:.0f}' for value in one)})" for one in self.examples_deg)
        sees = (
            "where the camera sees the board"
            if self.shown
            else "rotating the first and the last joint until the camera sees the board: these views do not say where it stands"
        )
        return (
            f"views in which gravity pulls joint {self.joint} ({self.name}) the other way: it does in {self.fewer} of "
            f"{self.views}, take {self.wanted} more, for example near {near} deg, {sees}"
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


def loaded(joints: int) -> range:
    """Joints, from 1, that gravity loads: the first is vertical, the last carries no moment about itself."""
    return range(2, joints)


def pulled(
    chain: Mapping[str, Any],
    q_deg: Sequence[Sequence[float]] | Floats,
    payloads_kg: Sequence[float],
    limits_deg: Sequence[tuple[float, float] | None],
    sights: Sequence[Sight] = (),
) -> list[Pulled]:
    """Count the views by the way in which gravity pulls each joint; nothing where ``chain`` does not tell its loads.

    ``chain`` is a robot document of convention ``chain``, ``q_deg`` (N, n) readings, ``payloads_kg`` (N,). Examples are poses
    at which one of the ``sights`` shows the board, where there are any.
    """
    q = np.array(q_deg, dtype=float)
    moments = gravity_moments(chain, q, np.array(payloads_kg, dtype=float))
    if moments is None:
        return []
    lacking, found = dict[int, float](), []
    for joint in loaded(q.shape[1]):
        up = int(np.sum(moments[:, joint - 1] > LEAST_LOAD_NM))
        down = int(np.sum(moments[:, joint - 1] < -LEAST_LOAD_NM))
        wanted = max(0, FEWEST_EITHER_WAY - min(up, down))
        if wanted:
            lacking[joint] = 1.0 if up < down else -1.0
        name = str(chain["joints"][joint - 1]["name"])
        found.append((joint, name, len(q), max(up, down), min(up, down), wanted))
    pull = _Sought(chain, q, sorted(set(payloads_kg)), limits_deg).examples(lacking, sights) if lacking else {}
    return [Pulled(*one, *pull.get(one[0], ((), None))) for one in found]


Examples = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class _Sought:
    """Where examples are sought: views ``seen`` (N, n), deg, of an arm, with payloads and limits of its joints."""

    chain: Mapping[str, Any]
    seen: Floats
    payloads: Sequence[float]
    limits: Sequence[tuple[float, float] | None]

    def examples(
        self, lacking: Mapping[int, float], sights: Sequence[Sight]
    ) -> dict[int, tuple[Examples, bool | None]]:
        """For each joint the poses nearest to those seen, at which gravity pulls it the way that is lacking, and whether
        the board is seen there: None where nothing says so, False where it is at none of them.
        """
        inner = [joint - 1 for joint in loaded(self.seen.shape[1])]
        grid = np.array(list(itertools.product(*(self._steps(k, STEPS_OF_A_JOINT) for k in inner))))
        poses = np.unique(self.seen, axis=0)
        away = np.stack([np.max(np.abs(grid - pose[inner]), axis=1) for pose in poses])
        tried = poses[np.argmin(away, axis=0)]
        tried[:, inner] = grid
        ends = sorted({self.payloads[0], self.payloads[-1]})
        moments = [gravity_moments(self.chain, tried, np.full(len(tried), kg)) for kg in ends]
        cost = {
            joint: np.where(
                _pulls([sign * one[:, joint - 1] for one in moments if one is not None]), away.min(axis=0), np.inf
            )
            for joint, sign in lacking.items()
        }
        if not sights:
            return {joint: (_apart(tried, grid, one), None) for joint, one in cost.items()}
        wanted = np.flatnonzero(np.isfinite(list(cost.values())).any(axis=0))
        hidden = np.ones(len(tried), dtype=bool)
        tried[wanted], hidden[wanted] = self._shown(tried[wanted], sights)
        return {joint: self._of_shown(tried, grid, one, hidden) for joint, one in cost.items()}

    def _of_shown(self, tried: Floats, grid: Floats, cost: Floats, hidden: Bools) -> tuple[Examples, bool | None]:
        within = bool(np.isfinite(cost).any())
        found = _apart(tried, grid, np.where(hidden, np.inf, cost))
        return found, (bool(found) if within else None)

    def _shown(self, poses: Floats, sights: Sequence[Sight]) -> tuple[Floats, Bools]:
        """The poses (N, n) with first and last joint where the board is seen best, and which (N,) show it nowhere."""
        out, last = poses.copy(), poses.shape[1] - 1
        pans, rolls = self._steps(0, WAYS_TO_SHOW), self._steps(last, WAYS_TO_SHOW)
        at_zero = np.linalg.inv(self._flanges(0, np.zeros(1))[0])
        before, after = self._flanges(0, pans) @ at_zero, at_zero @ self._flanges(last, rolls)
        straight = poses.copy()
        straight[:, [0, last]] = 0.0
        best = np.zeros(len(poses))
        for k, own in enumerate(flange(self.chain, straight)):
            score = np.max([one.score(before[:, None] @ (own @ after)) for one in sights], axis=0)
            a, b = np.unravel_index(np.argmax(score), score.shape)
            best[k], out[k, 0], out[k, last] = score[a, b], pans[a], rolls[b]
        return out, np.asarray(best <= LEAST_SHOWN)

    def _flanges(self, joint: int, readings: Floats) -> Floats:
        """Poses (N, 4, 4) of the flange with one joint at readings (N,), deg, and all others at zero."""
        q = np.zeros((len(readings), self.seen.shape[1]))
        q[:, joint] = readings
        return flange(self.chain, q)

    def _steps(self, k: int, steps: int) -> Floats:
        low, high = self.limits[k] or (-180.0, 180.0)
        off = OFF_STOPS * (high - low)
        return np.linspace(low + off, high - off, steps)


def _pulls(each: Sequence[Floats]) -> Bools:
    """Where gravity pulls clearly, with any payload if it can, else with one of them."""
    weakest, strongest = np.min(each, axis=0), np.max(each, axis=0)
    pull = weakest if weakest.max() > LEAST_LOAD_NM else strongest
    return np.asarray(pull > max(CLEARLY * float(pull.max()), LEAST_LOAD_NM))


def _apart(poses: Floats, inner: Floats, cost: Floats) -> tuple[tuple[float, ...], ...]:
    """The cheapest of the poses (N, n) whose inner joints (N, m) are apart; those of infinite cost never."""
    chosen, left = list[tuple[float, ...]](), cost.copy()
    while len(chosen) < MOST_EXAMPLES and np.isfinite(left).any():
        k = int(np.argmin(left))
        chosen.append(tuple(round(float(value), 1) for value in poses[k]))
        left[np.max(np.abs(inner - inner[k]), axis=1) < APART_DEG] = np.inf
    return tuple(chosen)
