"""Gates and verdicts (E7): what it takes to say an effect's name, and what to say when it is not enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.gap.adequacy import Adequacy
from core.gap.aliases import SAME, Alias, correlation
from core.gap.candidates import Candidate, Library
from core.gap.control import Control
from core.gap.hunt import Hunt
from core.gap.intervals import Amplitude

INCLUDED = 0.8
SURE_GAIN = 2.0  # standard errors
SHADOWED = 0.3  # correlation with an unknown curve above which a named effect may be part of it
CONTRADICTS = 2.0  # standard deviations on the wrong side of zero, or beyond the plausible range


@dataclass(frozen=True)
class Evidence:
    """What the gates look at for one chosen candidate."""

    place: int
    candidate: Candidate
    aliases: tuple[Alias, ...]
    inclusion: tuple[float, float]  # of its own name, of its class
    held_out: tuple[float, float]  # gain and its standard error
    control: Control | None
    amplitudes: tuple[Amplitude, ...]
    p_value: float
    gain_mm: float
    bumped: bool = False  # a local bump of its joint does as well


@dataclass(frozen=True)
class Judged:
    """Verdict on one candidate with the gates it passed; ``alias_set`` holds physical rivals only."""

    evidence: Evidence
    verdict: str
    gates: dict[str, bool]
    alias_set: tuple[Alias, ...]


def judge(hunt: Hunt, evidence: Evidence, adequate: bool | None, library: Library) -> Judged:
    """Pass one candidate through the gates: confirmed, class_confirmed, or provisional."""
    rivals = tuple(a for a in evidence.aliases if a.member or not a.candidate.empirical)
    gates = {
        "physical": not evidence.candidate.empirical,
        "adequate": bool(adequate),
        "held_out": evidence.held_out[0] > SURE_GAIN * evidence.held_out[1],
        "no_empirical_alias": len(rivals) == len(evidence.aliases)
        and not evidence.bumped
        and not _shadowed(hunt, evidence),
        "plausible": _plausible(evidence, library),
        "inclusion": evidence.inclusion[1 if rivals else 0] >= INCLUDED,
        "negative_control": evidence.control is None or evidence.control.passed,
    }
    if not all(gates.values()):
        return Judged(evidence, "provisional", gates, rivals)
    return Judged(evidence, "class_confirmed" if rivals else "confirmed", gates, rivals)


def run_verdict(judged: tuple[Judged, ...], adequacy: Adequacy) -> str:
    """Verdict of the run: no_gap, closed, unexplained, provisional."""
    if any(j.evidence.candidate.empirical for j in judged):
        return "unexplained"
    if adequacy.adequate is False:
        return "unexplained"
    if not judged:
        return "no_gap"
    return "provisional" if any(j.verdict == "provisional" for j in judged) else "closed"


def sentence(verdict: str, judged: tuple[Judged, ...], adequacy: Adequacy) -> str:
    """Say the verdict in words."""
    names = ", ".join(j.evidence.candidate.label for j in judged)
    relative = (
        "" if adequacy.adequate is not None else " The noise is that of the fit itself, so this is relative to it."
    )
    said = {
        "no_gap": "Nothing in the library stands out of the noise.",
        "closed": f"{names}: confirmed among the causes of the library. With this the model agrees with the measurements "
        "within their noise.",
        "provisional": f"{names}: likely, but not every test was passed.",
        "unexplained": "Something is left that no known effect explains."
        + (f" In part it looks like {names}." if names else ""),
    }
    return said[verdict] + relative


def _plausible(evidence: Evidence, library: Library) -> bool:
    for a in evidence.amplitudes:
        p = library.parameters[a.column]
        if a.value < p.lower - CONTRADICTS * a.sigma or a.value > p.upper + CONTRADICTS * a.sigma:
            return False
        if evidence.candidate.positive and len(evidence.amplitudes) == 1 and a.value <= 0.0:
            return False
    return True


def _shadowed(hunt: Hunt, evidence: Evidence) -> bool:
    """Whether an unknown curve was needed too, and could take this effect's place in part."""
    candidates = hunt.selector.scorer.candidates
    curves = [candidates[k] for k in hunt.chosen if candidates[k].empirical and k != evidence.place]
    return any(_related(hunt, evidence.candidate, c) for c in curves)


def _related(hunt: Hunt, candidate: Candidate, curve: Candidate) -> bool:
    """Same joint and a curve of the angle alone, or signatures that overlap after geometry."""
    same_joint = bool(set(candidate.joints or ()) & set(curve.joints or ()))
    of_angle = not candidate.effects[0].needs
    if same_joint and of_angle:
        return True
    rho = correlation(hunt.world.A, candidate.columns, curve.columns)
    return bool(rho > SHADOWED and rho < SAME) or bool(np.isclose(rho, 1.0))
