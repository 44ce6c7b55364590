"""What a finder said against what was hidden: the figures of the gap finder's benchmark, each with its bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import f, ncf, norm

from tests.blind.bounds import Figure, by_pose, share
from tests.blind.claims import (
    DECIDABLE,
    STRONG,
    TWINS_OF_CLOCK,
    Named,
    beside_the_point,
    covers,
    empirical,
    found,
    member,
    member_of_class,
    named,
    right,
    said_undecidable,
    slow,
    sure,
)
from tests.blind.parameters import intervals

Record = Mapping[str, Any]  # {"name", "case": {...}, "truth": {...}, "report": {...} | None, "error", "seconds"}

FLOORS = {1: "≥ 97 %", 2: "≥ 95 %", 3: "≥ 92 %"}
KINDS = ("no_gap", "named", "outside", "undecidable")
# What an ideal test is up against. A six-axis arm has some 450 candidates, whose signatures are alike.
FALSE_NAMES = 0.01  # chance that nothing hidden is named, as asked
INDEPENDENT = 100  # candidates whose signatures are not alike
HELD_OUT, HOLDS_OUT_FROM = (
    0.25,
    60,
)  # share of the poses that choose nothing, and the poses from which they are held out


def figures(records: Sequence[Record]) -> list[Figure]:
    """Every figure of the benchmark."""
    done = [r for r in records if r["report"] is not None]
    of = {k: [r for r in done if r["truth"]["expectation"] == k] for k in KINDS}
    return [
        *_false_alarms(of["no_gap"]),
        *_claims([r for r in done if r["truth"]["expectation"] != "undecidable"]),
        *_names(of["named"]),
        *_numbers(of["named"], done),
        *_sets(of["named"]),
        *_rest(records, done, of["undecidable"]),
    ]


def _false_alarms(empty: Sequence[Record]) -> list[Figure]:
    """Where nothing of the arm is hidden; where base or instrument moved, they may be named."""
    stable = [r for r in empty if not r["truth"]["background"]]
    moved = [r for r in empty if r["truth"]["background"]]
    return [
        share("any name when nothing is hidden", "≤ 1 %", [_any_name(r) for r in empty]),
        share("– the same, repeats stable", "≤ 1 %", [_any_name(r) for r in stable]),
        share("– the same, repeats drifting", "≤ 1 %", [_any_name(r) for r in moved]),
        share("confirmed when nothing is hidden", "0 of 400", [wrong(r) for r in empty]),
    ]


def _claims(records: Sequence[Record]) -> list[Figure]:
    claims = [(e, r["truth"]) for r in records for e in sure(r["report"]["effects"])]
    again = [(e, t) for e, t in claims if e["verdict"] == "replicated"]
    hard = [r for r in records if r["truth"]["background"] or r["truth"]["expectation"] == "outside"]
    twins = [r for r in records if any(h["id"] in TWINS_OF_CLOCK for h in r["truth"]["effects"])]
    unlisted = [r for r in records if r["truth"]["expectation"] == "outside"]
    return [
        share("confirmed but wrong, of confirmed names", "≤ 1 %", [not right(e, t) for e, t in claims]),
        share("runs with a confirmed but wrong name", "≤ 1 %", [wrong(r) for r in records]),
        share("– the same, drifting, smooth and outside cases alone", "≤ 2 %", [wrong(r) for r in hard]),
        share("– the same, smooth and outside cases alone", "≤ 2 %", [wrong(r) for r in unlisted]),
        share("– the same, twins of members that the library lacks", "≤ 0.5 %", [wrong(r) for r in twins]),
        share("replicated but wrong, of replicated names", "0 of 300", [not right(e, t) for e, t in again]),
    ]


def _names(records: Sequence[Record]) -> list[Figure]:
    effects = [(r, h) for r in records for h in r["truth"]["effects"]]
    alone = [(r, h) for r, h in effects if len(r["truth"]["effects"]) == 1 and h["lam"] >= STRONG]
    strong = [(r, h) for r, h in effects if h["lam_partial"] >= STRONG]
    clear = [(r, h) for r, h in strong if decidable(h)]
    seen = [(r, h) for r, h in strong if r["report"]["effects"]]
    return [
        share("power: a gap is named at λ ≥ 30", "≥ 95 %", [_seen(r) for r, _ in alone]),
        share("exact name at λ ≥ 30 and λ(1−ρ) ≥ 11", "≥ 97 %", [found(r["report"], h) for r, h in clear]),
        _expected([ideal(r, h) for r, h in clear]),
        share("truth in the alias set, λ ≥ 30", "≥ 98 %", [_in_class(r, h) for r, h in seen]),
        Figure("size of the alias set, median", "≤ 2", value=_median([_class_size(r, h) for r, h in seen])),
    ]


def ideal(r: Record, hidden: Named) -> float:
    """Chance that a test names an effect that knows the geometry, the other effects and the only rival.

    It has the poses and the freedom of the noise that the search has, and may name nothing hidden in ``FALSE_NAMES`` of
    the campaigns: an F-test of the effect's amplitudes at that level over ``INDEPENDENT`` candidates, and then the
    likelihood ratio of two simple hypotheses, whose logarithm is normal with mean q/2 and variance q, q = λ(1−ρ).
    """
    share_seen = 1.0 - HELD_OUT if r["case"]["poses"] >= HOLDS_OUT_FROM else 1.0
    seen = share_seen * hidden["lam_partial"]
    noise = r["report"]["noise"]
    known = float(noise["freedom"] or 0.0) if noise["absolute"] else 3.0 * share_seen * r["case"]["poses"]
    known = max(known, 1.0)
    free = hidden["freedom"]
    limit = f.isf(FALSE_NAMES / INDEPENDENT, free, known)
    return float(ncf.sf(limit, free, known, seen) * norm.cdf(0.5 * math.sqrt(seen * (1.0 - rho_of(hidden)))))


def _numbers(records: Sequence[Record], done: Sequence[Record]) -> list[Figure]:
    alone = [r for r in records if len(r["truth"]["effects"]) == 1 and r["truth"]["effects"][0]["lam"] >= STRONG]
    predicted = [(int(k), int(n)) for r in done for k, n in (_predictive(r) or {}).get("poses") or ()]
    return [
        share("95 % intervals of parameters that hold the truth", "94 – 96 % of 2000", intervals(records)),
        by_pose("95 % predictive intervals that hold held-out coordinates", "93 – 97 % of 2000", predicted),
        Figure("hold-out gap closure, pooled", "≥ 95 %", value=100.0 * closure(alone), unit=" %", n=len(alone)),
    ]


def _predictive(r: Record) -> Mapping[str, Any] | None:
    report = r["report"]
    return report.get("predictive") or report["gap"].get("predictive")


def _sets(records: Sequence[Record]) -> list[Figure]:
    out = []
    for k, floor in FLOORS.items():
        own = [r for r in records if _demanded(r, k)]
        whole = [math.prod(ideal(r, h) for h in r["truth"]["effects"]) for r in own]
        out += [
            share(f"exact hidden set, {k} decidable", f"{floor} of 150", [exact(r) for r in own]),
            _expected(whole),
        ]
    return out


def _expected(chances: Sequence[float]) -> Figure:
    """What an ideal test would reach on average, in percent."""
    value = 100.0 * float(np.mean(chances)) if chances else math.nan
    return Figure("– the same, expected of an ideal test", "", value=value, unit=" %", n=len(chances))


def _rest(records: Sequence[Record], done: Sequence[Record], open_: Sequence[Record]) -> list[Figure]:
    admitted = [said_undecidable(r["report"], r["truth"]["undecidable"]) for r in open_]
    longest = max((r["seconds"] for r in records), default=math.nan)
    return [
        share("undecidable said undecidable", "≥ 98 %", admitted),
        Figure(
            "seconds of the processor per run, median", "≤ 5", value=_median([r["seconds"] for r in done]), unit=" s"
        ),
        Figure("seconds of the processor per run, longest", "≤ 30", value=longest, unit=" s"),
        share("runs that failed", "0", [r["report"] is None for r in records]),
    ]


def rho_of(hidden: Named) -> float:
    """Likeness of the nearest rival that counts against the effect, as the generator found it."""
    return float(hidden["rho"])


def decidable(hidden: Named) -> bool:
    """Whether an effect stands out of its rivals enough for its name to be demanded."""
    return bool(hidden["lam_partial"] * (1.0 - rho_of(hidden)) >= DECIDABLE)


def wrong(r: Record) -> bool:
    """Whether a run claims anything that is not so."""
    return any(not right(e, r["truth"]) for e in sure(r["report"]["effects"]))


def exact(r: Record) -> bool:
    """Whether a run names all that is hidden and nothing else; what else is true of the campaign may be said."""
    truth = r["truth"]
    known = all(
        beside_the_point(e, truth) or any(named(e, h) or member(e, h) for h in truth["effects"])
        for e in r["report"]["effects"]
    )
    return known and all(found(r["report"], h) for h in truth["effects"])


def closure(records: Sequence[Record]) -> float:
    """(R0² − R1²) / (R0² − σ²) on held-out poses, sums over the runs; σ is what noise alone would leave there."""
    gaps = [r["report"]["gap"] for r in records]
    kept = [g for g in gaps if g.get("validation_before_mm") is not None and g.get("validation_noise_rms_mm")]
    won = sum(g["validation_before_mm"] ** 2 - g["validation_after_mm"] ** 2 for g in kept)
    there = sum(g["validation_before_mm"] ** 2 - g["validation_noise_rms_mm"] ** 2 for g in kept)
    return won / there if there > 0 else math.nan


def _any_name(r: Record) -> bool:
    """Any name at all; where base or instrument moved, any cause in the arm."""
    effects = r["report"]["effects"]
    if not r["truth"]["background"]:
        return bool(effects)
    return any(not slow(e) and not empirical(e) for e in effects)


def _seen(r: Record) -> bool:
    return any(not beside_the_point(e, r["truth"]) for e in r["report"]["effects"])


def _demanded(r: Record, count: int) -> bool:
    """Whether a run hides so many effects, each visible beside the others and told from its rivals."""
    truth = r["truth"]["effects"]
    return len(truth) == count and all(decidable(h) and h["lam_partial"] >= STRONG for h in truth)


def _in_class(r: Record, hidden: Named) -> bool:
    effects = r["report"]["effects"]
    return found(r["report"], hidden) or any(covers(e, hidden) or member_of_class(e, hidden) for e in effects)


def _class_size(r: Record, hidden: Named) -> float:
    effects = [e for e in r["report"]["effects"] if covers(e, hidden) or member(e, hidden)]
    sizes = [1 + len(e.get("alias_set", ())) for e in effects]
    return float(min(sizes)) if sizes else math.nan


def _median(values: Sequence[float]) -> float:
    return float(np.nanmedian(values)) if len(values) and not np.all(np.isnan(values)) else math.nan
