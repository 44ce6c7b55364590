"""Which way gravity pulls each joint over the views: where it is always the same way, backlash and zero are one number."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kilter_files.ground.arrays import Floats
from kilter_files.ground.later import np
from kilter_files.rig.kit.moments import gravity_moments

LEAST_LOAD_NM = 0.05  # well beyond the friction of a servo: it rests on one flank then
FEWEST_EITHER_WAY = 6  # views
CLEARLY = 0.5  # of the most that gravity can pull so: whoever comes near an example still has the other way
OFF_STOPS = 0.03  # of a joint's range
MOST_EXAMPLES, APART_DEG = 3, 30.0
STEPS_OF_A_JOINT = 13  # of the poses among which an example is sought


@dataclass(frozen=True)
class Pulled:
    """How many views gravity pulls a joint the one way, and the other; ``wanted`` more of the fewer.

    ``examples_deg`` are readings at which it pulls the fewer way, those near views that are there first, several for a camera
    may not see the board at each; none where none is within the limits, or none is wanted.
    """

    joint: int
    name: str
    views: int
    more: int
    fewer: int
    wanted: int
    examples_deg: tuple[tuple[float, ...], ...]

    @property
    def missing(self) -> str | None:
        """What to photograph; None where nothing is missing, or the arm cannot."""
        if not self.examples_deg:
            return None
        near = " or ".join(f"({', '.join(f'{value:.0f}' for value in one)})" for one in self.examples_deg)
        return (
            f"views in which gravity pulls joint {self.joint} ({self.name}) the other way: it does in {self.fewer} of "
            f"{self.views}, take {self.wanted} more, for example near {near} deg"
        )

    @property
    def untold(self) -> str | None:
        """Why backlash of this joint cannot be told; None where it can."""
        if not self.wanted:
            return None
        cannot = "" if self.examples_deg else ", and within the limits of the joints no pose changes that"
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
) -> list[Pulled]:
    """Count the views by the way in which gravity pulls each joint; nothing where ``chain`` does not tell its loads.

    ``chain`` is a robot document of convention ``chain``, ``q_deg`` (N, n) readings, ``payloads_kg`` (N,).
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
    examples = _examples(chain, q, sorted(set(payloads_kg)), limits_deg, lacking) if lacking else {}
    return [Pulled(*one, examples.get(one[0], ())) for one in found]


def _examples(
    chain: Mapping[str, Any], seen: Floats, payloads: Sequence[float], limits: Sequence[tuple[float, float] | None],
    lacking: Mapping[int, float],
) -> dict[int, tuple[tuple[float, ...], ...]]:  # fmt: skip
    """For each joint the poses nearest to those seen, at which gravity pulls it the way that is lacking."""
    inner = [joint - 1 for joint in loaded(seen.shape[1])]
    spans = [_off_the_stops(limits[k]) for k in inner]
    grid = np.array(list(itertools.product(*(np.linspace(low, high, STEPS_OF_A_JOINT) for low, high in spans))))
    poses = np.unique(seen, axis=0)
    away = np.stack([np.max(np.abs(grid - pose[inner]), axis=1) for pose in poses])
    tried = poses[np.argmin(away, axis=0)]
    tried[:, inner] = grid
    moments = [gravity_moments(chain, tried, np.full(len(tried), kg)) for kg in {payloads[0], payloads[-1]}]
    nearest, out = np.min(away, axis=0), {}
    for joint, sign in lacking.items():
        each = [sign * one[:, joint - 1] for one in moments if one is not None]
        weakest, strongest = np.min(each, axis=0), np.max(each, axis=0)
        pull = weakest if weakest.max() > LEAST_LOAD_NM else strongest
        fit = pull > max(CLEARLY * float(pull.max()), LEAST_LOAD_NM)
        out[joint] = _apart(tried, grid, np.where(fit, nearest, np.inf))
    return out


def _off_the_stops(limits: tuple[float, float] | None) -> tuple[float, float]:
    low, high = limits or (-180.0, 180.0)
    return low + OFF_STOPS * (high - low), high - OFF_STOPS * (high - low)


def _apart(poses: Floats, inner: Floats, cost: Floats) -> tuple[tuple[float, ...], ...]:
    """The cheapest of the poses (N, n) whose inner joints (N, m) are apart; those of infinite cost never."""
    chosen, left = list[tuple[float, ...]](), cost.copy()
    while len(chosen) < MOST_EXAMPLES and np.isfinite(left).any():
        k = int(np.argmin(left))
        chosen.append(tuple(round(float(value), 1) for value in poses[k]))
        left[np.max(np.abs(inner - inner[k]), axis=1) < APART_DEG] = np.inf
    return tuple(chosen)
