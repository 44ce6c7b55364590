"""Negative control (E7): the labels an effect lives on are shuffled over the poses, and its name must vanish."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import whitened_unit_columns
from kilter_core.gap.search.linear.settings import tail
from kilter_core.gap.search.scan import grouping, residual_given
from kilter_core.observations import CONDITIONS
from kilter_core.types import Floats, Ints

LABELS = {
    "direction": ("direction",),
    "moments": ("wrench", "axial", "end_wrench", "base_wrench", "centre_wrench", "centre_axial"),
    "payload_kg": ("payload_kg", "payload_axial"),
    "temperature_c": ("temperature_c",),
    "t": ("t",),
    "session": ("session",),
    "qd": ("qd",),
    "base_tilt_x": ("base_tilt_x", "base_tilt_y"),
}
LABELS |= {name: (name,) for name in CONDITIONS if name not in LABELS}
WORDS = {"moments": "load", "payload_kg": "load", "temperature_c": "temperature", "t": "time", "qd": "speed"}
WORDS |= {"base_tilt_x": "tilt of the base"}
SURVIVING = 0.1  # share of shuffles in which a name may come back before the control counts as failed
LARGE = 3000  # visits above which fewer shuffles do
FEW = 8


@dataclass(frozen=True)
class Control:
    """Outcome for one effect: what was shuffled, how often, and in which share the effect was still named."""

    place: int
    label: str
    shuffles: int
    survived: float

    @property
    def has_passed(self) -> bool | None:
        """Whether the name vanished; None where no shuffle tried it."""
        return self.survived <= SURVIVING if self.shuffles else None


def controls(
    search: SearchResult,
    places: Sequence[int],
    shuffles: int,
    seed: int,
    progress: Callable[[float], None],
    over: Callable[[], bool] = lambda: False,
) -> tuple[Control, ...]:
    """Shuffle for every chosen effect. One that needs no label has the residual vectors shuffled over the poses.

    ``places`` are the chosen ones, what matters most first: where time is ``over`` the rest is not shuffled, and
    one that fewer shuffles tried than tell anything is not tested.
    """
    rng = np.random.default_rng(seed)
    count = min(shuffles, FEW) if len(search.problem.settings.used) > LARGE else shuffles
    out = []
    for n, place in enumerate(places):
        bench = _Bench.from_search(search, place)
        label = bench.label
        hits = tried = 0
        for k in range(count):
            if over():
                hits, tried = (hits, tried) if tried >= FEW else (0, 0)
                break
            tried += 1
            progress((n + k / count) / len(places))
            order = _order(
                search.problem.settings.group, rng, label is not None and search.problem.settings.inflation <= 1.0
            )
            hits += bench.poses_named(order) if label is None else bench.label_named(label, order)
        out.append(
            Control(place, "poses" if label is None else WORDS.get(label, label), tried, hits / tried if tried else 0.0)
        )
    return tuple(out)


def _label_to_shuffle(candidate: Candidate) -> str | None:
    """What to shuffle; a change of the loads acts through other effects, which a shuffled load would take along."""
    effect = candidate.effects[0]
    return None if effect.changes_loads else next((need for need in LABELS if need in effect.needs), None)


def false_names(search: SearchResult, shuffles: int, seed: int) -> float:
    """Share of shuffles of the residuals over the poses in which anything at all would be named."""
    rng = np.random.default_rng(seed)
    problem, selector = search.problem, search.selector
    size = problem.settings.whitener.shape[-1]
    basis = problem.basis(search.columns)
    r = residual_given(problem, search.columns).reshape(-1, size)
    given = problem.gram.condition_on_columns(search.columns)
    columns = problem.projection
    hits = 0
    for _ in range(shuffles):
        mixed = r[_order(problem.settings.group, rng)].reshape(-1)
        mixed = mixed - basis @ (basis.T @ mixed)
        k, _ = selector.entry(given.with_data(columns.under(mixed), float(mixed @ mixed)), (), search.critical)
        hits += k is not None
    return hits / shuffles


def control_document(search: SearchResult, shuffled: Sequence[Control], shuffles: int, seed: int) -> dict[str, Any]:
    """What the shuffles of every effect came to, and how often shuffled residuals name anything."""
    rows = [
        {
            **search.selector.scorer.candidates[c.place].id_and_joints(),
            "shuffled": c.label,
            "shuffles": c.shuffles,
            "survived": c.survived,
            "passed": c.has_passed,
        }
        for c in shuffled
    ]
    return {
        "passed": all(c.has_passed is not False for c in shuffled),
        "effects": rows,
        "shuffles": shuffles,
        "names_in_shuffled_residuals": false_names(search, shuffles, seed),
    }


def _order(group: Ints, rng: np.random.Generator, inside: bool = False) -> Ints:
    """Shuffle of the visits that keeps the visits of a pose together as far as their numbers allow.

    ``inside`` shuffles the visits of each pose too: where every pose was approached from below and then from above, any
    order of whole poses has the labels that it had before.
    """
    poses = rng.permutation(int(group.max()) + 1)
    rank = np.argsort(poses)
    ties = rng.permutation(len(group)) if inside else np.arange(len(group))
    return np.lexsort((ties, rank[group])).astype(np.int64)


@dataclass(frozen=True)
class _Bench:
    """One chosen effect on shuffled labels or residuals; what no shuffle changes is made once."""

    search: SearchResult
    place: int
    label: str | None
    basis: Floats  # of geometry and the other effects
    left: Floats  # by them

    @staticmethod
    def from_search(search: SearchResult, place: int) -> _Bench:
        rest = search.selector.columns([k for k in search.chosen if k != place])
        label = _label_to_shuffle(search.selector.scorer.candidates[place])
        basis = search.problem.basis(rest)
        return _Bench(search, place, label, basis, residual_given(search.problem, rest, basis))

    @property
    def columns(self) -> list[int]:
        return list(self.search.selector.scorer.candidates[self.place].columns)

    def label_named(self, label: str, order: Ints) -> bool:
        """Whether the effect, fed with shuffled labels, would still be entered in its own place."""
        problem = self.search.problem
        batch = problem.settings.source.batch
        shuffled = replace(batch, **{n: v[order] for n in LABELS[label] if (v := getattr(batch, n)) is not None})
        return self._has_significant_columns(
            whitened_unit_columns(problem.settings, problem.values, shuffled, self.columns)[0], self.left
        )

    def poses_named(self, order: Ints) -> bool:
        """Whether the effect would be entered for the residuals of other poses."""
        problem = self.search.problem
        size = problem.settings.whitener.shape[-1]
        r = self.left.reshape(-1, size)[order].reshape(-1)
        return self._has_significant_columns(problem.W_raw[:, self.columns], r - self.basis @ (self.basis.T @ r))

    def _has_significant_columns(self, columns: Floats, r: Floats) -> bool:
        W = self.search.problem.soft(columns)
        return _is_effect_significant(self.search, self.place, W - self.basis @ (self.basis.T @ W), r)


def _is_effect_significant(search: SearchResult, place: int, W: Floats, r: Floats) -> bool:
    u, s, _ = np.linalg.svd(W, full_matrices=False)
    u = u[:, s > 1e-3]
    d = u.shape[1]
    if not d:
        return False
    settings = search.problem.settings
    limit = search.critical if search.strict is None else search.strict
    if settings.inflation > 1.0:
        blocks = settings.group[search.problem.row_visit]
        return bool(tail(*by_blocks(u, r, blocks)) < limit)
    S = float(np.sum((u.T @ r) ** 2))
    free = max(search.problem.nu - d, 1.0)
    variance = max(1.0, (float(r @ r) - S) / free)
    scorer = search.selector.scorer
    return bool(tail(S / variance, d, scorer.noise_freedom(free)) < limit)


def by_blocks(u: Floats, r: Floats, blocks: Ints) -> tuple[float, int, float]:
    """Chi-square of the sum of the blocks' shares u'r by their own scatter, its directions, and its freedom.

    The residual still holds the effect, and is then as smooth as the motion: its samples are far from independent,
    whatever the noise is. A shuffled label matches a true delay in a few cycles by chance, which a test that counts
    samples calls certain. Blocks that were shuffled are independent of one another.
    """
    share = grouping(blocks, int(blocks.max()) + 1, r) @ u
    share = share[np.any(share != 0.0, axis=1)]
    count, d = len(share), u.shape[1]
    if count <= d + 1:
        return 0.0, d, 1.0
    apart = share - share.mean(axis=0)
    total = share.sum(axis=0)
    size = float(total @ np.linalg.pinv(apart.T @ apart * count / (count - 1), hermitian=True) @ total)
    return size * (count - d) / (count - 1), d, float(count - d)  # Hotelling's T as chi-square over an estimate
