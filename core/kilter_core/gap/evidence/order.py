"""What went with the clock: whether poses were measured in random order, and else which joint, height or load rose with it.

A law of time may be named where nothing that follows the posture can be what went with it. Neighbours in the space of
the joints, of the tool, or along any one of them are then neighbours in time no more often than in a shuffled order, and
none of them rises or falls with the clock.
Polynomials of the posture are too poor for this: what a climbing arm leaves of them still goes along with the clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from scipy.stats import rankdata

from kilter_core.gap.search.sources.source import Source
from kilter_core.observations.clock import read_clock
from kilter_core.types import Bools, Floats

NEIGHBOURS = 4  # visits nearest to one that say when it was
SHUFFLES = 400  # of the clock
RANDOM = 0.01  # chance of a random order beyond which it is taken for one
FEWEST_VISITS = 20  # below which no order is called random
LOOKED_AT = 2000  # visits at most
GOES_ALONG = 0.3  # rank correlation with the clock that is worth a word
SPREAD = 1e-6  # rad or m: what varies less does not vary


@dataclass(frozen=True)
class Order:
    """Chance of neighbours so near in time in a random order, and what ``went`` along most, with its rank correlation."""

    chance: float
    visits: int
    went: str
    correlation: float

    @property
    def random(self) -> bool:
        """Whether nothing of the posture can have gone with the clock."""
        return self.visits >= FEWEST_VISITS and self.chance > RANDOM

    @property
    def words(self) -> str:
        """What went with the clock, for people."""
        if abs(self.correlation) < GOES_ALONG:
            return "poses near each other were measured one after another"
        verb = "rose" if self.correlation > 0.0 else "fell"
        return f"{self.went} {verb} with the clock (correlation {self.correlation:.2f})"


def assess_visit_order(source: Source, used: Bools, seed: int = 0) -> Order:
    """Compare the order of the visits used with shuffles of it."""
    rng = np.random.default_rng(seed)
    visits = np.flatnonzero(used)
    if len(visits) > LOOKED_AT:
        visits = np.sort(rng.choice(visits, LOOKED_AT, replace=False))
    when = np.empty(len(used))
    when[read_clock(source.observations).order] = np.arange(len(used))
    clock = rankdata(when[visits])
    single, whole = _postures(source)
    single = {name: x[visits] for name, x in single.items() if np.ptp(x[visits]) > SPREAD}
    along = {name: float(np.corrcoef(clock, rankdata(x))[0, 1]) for name, x in single.items()}
    went = max(along, key=lambda name: abs(along[name]), default="")
    spaces = [*(x[:, None] for x in single.values()), *(x[visits] for x in whole)]
    chance = _chance(clock, spaces, rng) if len(visits) > 2 * NEIGHBOURS else 0.0
    return Order(chance, len(visits), went, along.get(went, 0.0))


def _postures(source: Source) -> tuple[Mapping[str, Floats], tuple[Floats, ...]]:
    """What may go with the clock: single numbers (V,) by name, and whole spaces (V, k)."""
    rows, tool = source.observations, source.batch.tool_point
    single = {f"joint {j + 1}": rows.q[:, j] for j in range(rows.q.shape[1])}
    single |= {
        "the height of the tool": tool[:, 2], "the reach of the tool": np.hypot(tool[:, 0], tool[:, 1]),
        "x of the tool": tool[:, 0], "y of the tool": tool[:, 1],
    }  # fmt: skip
    if rows.payload_kg is not None:
        single["the payload"] = rows.payload_kg
    if rows.direction is not None:
        single |= {f"the approach of joint {j + 1}": rows.direction[:, j] for j in range(rows.q.shape[1])}
    return single, (rows.q, tool)


def _chance(clock: Floats, spaces: list[Floats], rng: np.random.Generator) -> float:
    """Share of shuffles in which some space goes along with time as the real order does, or more.

    By neighbours, which see any function of the posture, and by rank, which sees a weak trend better.
    """
    c = (clock - clock.mean()) / max(float(clock.std()), 1e-300)
    shuffled = np.stack([c, *(rng.permutation(c) for _ in range(SHUFFLES))])
    beyond = []
    for space in spaces:
        ranks = np.stack([rankdata(x) for x in space.T], axis=1)
        near = np.sum((_means(space, rng) @ shuffled.T).T * shuffled, axis=1)
        along = np.abs(shuffled @ (ranks - ranks.mean(axis=0))).T
        beyond += [(x - x[1:].mean()) / max(float(x[1:].std()), 1e-300) for x in (near, *along)]
    most = np.max(beyond, axis=0)
    return float((1 + np.sum(most[1:] >= most[0])) / (1 + SHUFFLES))


def _means(space: Floats, rng: np.random.Generator) -> csr_array:
    """Matrix (V, V) of the mean over the neighbours of each visit; ties are broken by chance."""
    x = space / np.maximum(space.std(axis=0), 1e-12)
    x = x + 1e-6 * rng.normal(size=x.shape)
    near = np.asarray(KDTree(x).query(x, NEIGHBOURS + 1)[1])[:, 1:]
    rows = np.repeat(np.arange(len(x)), NEIGHBOURS)
    return csr_array((np.full(near.size, 1.0 / NEIGHBOURS), (rows, near.reshape(-1))), shape=(len(x), len(x)))
