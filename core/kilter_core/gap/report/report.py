"""The result of a gap search, as objects and as the document of the contract (mm, degrees, joints from 1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kilter_core.errors import FindingDocument
from kilter_core.gap.evidence.claim import CLASS
from kilter_core.gap.evidence.held_out.adequacy import Adequacy
from kilter_core.gap.evidence.held_out.practical_size import Misfit
from kilter_core.gap.evidence.held_out.unseen_fit import UnseenFit
from kilter_core.gap.evidence.similarity.aliases import Alias
from kilter_core.gap.evidence.verdict import Judged
from kilter_core.gap.report.localization import Place
from kilter_core.gap.report.separation import ToldApart
from kilter_core.gap.report.stored import Stored
from kilter_core.gap.search.candidates import Library, Untestable
from kilter_core.gap.study import POSES_TO_SPARE_SOME
from kilter_core.model import Calibration
from kilter_core.parameters import display_unit_and_scale
from kilter_core.types import Ints

REMEDIES = {
    "physical": "It has a shape and no cause: look for a cause outside the library.",
    "lasts": "Something else is left, or the noise is not known, and its own evidence does not reach: both halves of the "
    "campaign, or a confirmation, must show its name with the same amplitude and be predicted better by it. Repeat ten "
    "poses three times, leaving them in between, or measure more poses.",
    "held_out": "Held-out poses do not clearly gain by it: measure more poses.",
    "unseen_poses": f"No pose judged it that did not choose it: measure {POSES_TO_SPARE_SOME} poses or more (a quarter is "
    "then held out), give `validation`, or measure a `confirmation` campaign on another day.",
    "no_empirical_alias": "A shape without a cause does as well: measure the poses asked for, over more of the joint's range.",
    "plausible": "Its amplitude is not plausible for an arm: check units, masses and payloads.",
    "seen": "No parameter of it differs from zero by itself: measure more poses at its joints.",
    "inclusion": "Other poses of the same kind would not always name it: measure more poses.",
    "negative_control": "Its name comes back where labels are shuffled: vary what it depends on independently of the pose.",
    "sensor": "A sensor at the place does not show it: something else moved, or went with what this follows. Look at "
    "the instrument, and at the sensor's place, sign and unit.",
    "complete_geometry": "The robot's description lacks rotations of axes that explain the rows as well: describe the robot "
    "with a complete chain (convention poe, cpc or mcpc), and search again.",
    "confirmation": "The confirmation shows another amplitude, or errs more with it: look what changed between the campaigns.",
}


def to_confirm(judged: Judged) -> list[str]:
    """What is missing to a higher level, a sentence for each gate that was not passed, and one for those not tested."""
    untested = [name for name, passed in judged.gates.items() if passed is None]
    later = f"Not tested in the time: {', '.join(untested)}. Search again with a larger budget_s."
    failed = [REMEDIES[name] for name, passed in judged.gates.items() if passed is False]
    return [*failed, later] if untested else failed


MOST_PLACES = 60
SURE = 0.05


@dataclass(frozen=True)
class Remains:
    """What is left after everything that was named: its size, and the ``place`` where it is clearest."""

    misfit: Misfit
    place: Place | None

    @property
    def words(self) -> str:
        """Size and place in brackets, with a space before; empty where neither is known, or the rows searched leave nothing."""
        size = "" if self.misfit.rms_mm is None or self.misfit.adequate else self.misfit.size_text
        where = "" if self.place is None else f"mostly at {self.place.factor} {self.place.level}"
        told = ", ".join(part for part in (size, where) if part)
        return f" ({told})" if told else ""

    def to_document(self, fit: Adequacy, unseen: UnseenFit | None) -> dict[str, Any]:
        """The statement on the model as a whole, by the rows searched and by those that no choice saw."""
        elsewhere = unseen is not None and unseen.refutes_model
        told = "" if unseen is None else unseen.sentence()
        return {
            "sentence": ("Something else remains." if fit.adequate and elsewhere else fit.sentence(self.words)) + told,
            "mostly_at": None if self.place is None or fit.adequate else place_row(self.place),
        }


@dataclass(frozen=True)
class GapReport:
    """What the search found. ``stored`` holds the named effects; ``to_document()`` is the job's result."""

    stored: Stored
    verdict: str
    sentence: str
    effects: tuple[Judged, ...]
    where: tuple[Place, ...]
    gap: dict[str, Any]
    measurements: list[dict[str, Any]]
    adequacy: Adequacy
    misfit: Misfit
    remains: Remains
    predictive: dict[str, Any] | None
    not_testable: tuple[Untestable, ...]
    smallest_detectable: list[dict[str, Any]]
    refused: list[dict[str, Any]]
    next_poses: list[dict[str, Any]]
    told_apart: ToldApart | None
    negative_control: dict[str, Any]
    alias_matrix: dict[str, Any]
    noise: dict[str, Any]
    warnings: tuple[FindingDocument, ...]
    figures: dict[str, Any]
    effect_curves: list[dict[str, Any]]
    library: Library
    unseen: UnseenFit | None = (
        None  # how rows that no choice saw agree; None: none were held out, or nothing to judge by
    )
    set_aside: tuple[dict[str, Any], ...] = ()  # rows searched, from 0 as given
    held_aside: tuple[
        dict[str, Any], ...
    ] = ()  # rows held out, from 0 as given: of the validation, or with a share of all
    spikes: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # the same among the rows held out

    @property
    def calibration(self) -> Calibration:
        """The final fit: geometry and named effects."""
        return self.stored.calibration

    def to_document(self) -> dict[str, Any]:
        """The gap result of the contract."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": [effect_row(j, self.library, self.misfit) for j in self.effects],
            "where": [place_row(p) for p in _places_to_report(self.where)],
            "gap": self.gap,
            "measurements": self.measurements,
            "predictive": self.predictive,
            "adequacy": self.adequacy.to_document()
            | self.misfit.to_document()
            | self.remains.to_document(self.adequacy, self.unseen)
            | {"held_out": None if self.unseen is None else self.unseen.to_document()},
            "noise": self.noise,
            "not_testable": [untestable_row(u) for u in self.not_testable],
            "smallest_detectable": self.smallest_detectable,
            "refused": self.refused,
            "next_poses": self.next_poses,
            "told_apart": None if self.told_apart is None else self.told_apart.to_document(),
            "negative_control": self.negative_control,
            "alias_matrix": self.alias_matrix,
            "warnings": list(self.warnings),
            "set_aside": list(self.set_aside),
            "held_aside": list(self.held_aside),
            "figures": self.figures,
            "effect_curves": self.effect_curves,
            "load_model": self.stored.load_model(),
            "null_directions": self.stored.null_directions(),
            "reference": self.stored.reference(),
        }


def effect_row(judged: Judged, library: Library, misfit: Misfit) -> dict[str, Any]:
    """One named effect."""
    evidence = judged.evidence
    gain, error, deviations = evidence.held_out
    replication = evidence.replication
    units = {p.name: p.unit for p in library.parameters}
    return {
        **evidence.candidate.id_and_joints(),
        "verdict": judged.verdict,
        "empirical": evidence.candidate.empirical,
        "class": judged.claim.words if judged.claim.said == CLASS else None,
        **judged.claim.to_document(),
        "alias_set": [alias_row(a) for a in judged.alias_set],
        "parameters": [
            amplitude_row(library, a.column, a.value, a.sigma, (a.low, a.high)) | {"seen": a.is_significant}
            for a in evidence.amplitudes
        ],
        "seen_joints": None if evidence.seen_joints is None else [j + 1 for j in evidence.seen_joints],
        "gain_mm": evidence.gain_mm,
        "moves_mm": evidence.moves_mm if np.isfinite(evidence.moves_mm) else None,
        "too_small_to_matter": not misfit.matters(evidence.moves_mm),
        "p_value": evidence.p_value,
        "inclusion": judged.numbers["inclusion"],
        "held_out_gain": {"gain": gain, "standard_error": error, "deviations": deviations},
        "gates": judged.gates,
        "evidence": judged.numbers,
        "replication": None if replication is None else replication.to_document(units),
        "halves": None if evidence.halves is None else evidence.halves.to_document(),
        "to_confirm": to_confirm(judged),
    }


def alias_row(alias: Alias) -> dict[str, Any]:
    """A rival that does as well."""
    return {
        **alias.candidate.id_and_joints(),
        "behind": alias.behind,
        "correlation": alias.correlation,
        "p_wrong": alias.wrong,
    }


def amplitude_row(
    library: Library, column: int, value: float, sigma: float, interval: tuple[float, float]
) -> dict[str, Any]:
    """A parameter in wire units, its interval conditional on the library."""
    parameter = library.parameters[column]
    unit, scale = display_unit_and_scale(parameter.unit)
    return {
        "name": parameter.name,
        "value": value * scale,
        "unit": unit,
        "sigma": sigma * scale,
        "interval_low": interval[0] * scale,
        "interval_high": interval[1] * scale,
    }


def place_row(place: Place) -> dict[str, Any]:
    """A level of a factor."""
    return {
        "factor": place.factor,
        "level": place.level,
        "excess": place.excess,
        "p_value": place.p_value,
        "visits": place.visits,
    }


def untestable_row(u: Untestable) -> dict[str, Any]:
    """What cannot be tested, and how to test it."""
    return {
        "id": u.id,
        "joints": None if u.joints is None else [j + 1 for j in u.joints],
        "reason": u.reason,
        "remedy": u.remedy,
        "missing": u.missing or None,
    }


def _places_to_report(places: tuple[Place, ...]) -> tuple[Place, ...]:
    sure = tuple(p for p in places if p.p_value < SURE)
    return sure[:MOST_PLACES] if len(sure) >= 10 else places[:10]
