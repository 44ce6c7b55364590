"""The limits of a claim in plain words: what is not known, what cannot be told apart, where it does not hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from kilter_files.look import why_unusual
from kilter_service.contract.fits import Parameter, split_nominal_and_moved
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.versions import Version
from kilter_service.page.words import of_joints

VERDICTS = {
    "replicated": "seen again in a measurement of another day or set-up, no narrower than its claim",
    "confirmed": "confirmed within this measurement; another day or set-up has not shown it again",
    "class_confirmed": "confirmed as one of a class that these rows cannot tell apart",
    "provisional": "provisional: not all tests were passed",
    "contradicted": "contradicted by rows that took no part in the search, and left out of the version",
}
EXTRAPOLATES = (
    "Outside the joint ranges, loads and temperatures that were measured the calibration extrapolates: the errors stated "
    "here do not hold there."
)


def limits(version: Version, search: GapResult | None) -> list[str]:
    """Return what the version does not claim, one sentence each."""
    return [*_errors(version), *_unknown(version), *_limits_of_search(search), EXTRAPOLATES]


def _errors(version: Version) -> Iterator[str]:
    if version.metrics.validation is None:
        yield "No pose was held out: the errors stated here are of poses that were fitted, and are smaller than elsewhere."
    yield from (one.message for one in version.objections)
    yield from (one.message for one in version.warnings)


def _unknown(version: Version) -> Iterator[str]:
    nominal, moved = split_nominal_and_moved(
        one for one in version.parameters if one.identifiable is False and not one.from_prior
    )
    if nominal:
        yield f"These poses cannot determine {_names(nominal)}: their values are those of the nominal robot."
    if moved:
        yield (
            f"These poses cannot determine {_names(moved)}: their values are not nominal, one guess of many that fit as "
            "well. Read them only together."
        )
    yield from (one.sentence for one in version.null_directions if one.sentence)
    odd = [one for one in version.parameters if one.plausible is False]
    for why in dict.fromkeys(why_unusual(one.name, one.value, one.sigma) for one in odd):
        alike = [one for one in odd if why_unusual(one.name, one.value, one.sigma) == why]
        yield f"Of {_names(alike)} these rows say: {why}. Check before you rely on them."


def _names(found: Sequence[Parameter]) -> str:
    return ", ".join(one.name for one in found)


def _limits_of_search(search: GapResult | None) -> Iterator[str]:
    for effect in (search.effects if search is not None else None) or []:
        verdict = VERDICTS.get(effect.verdict or "")
        where = f" of {of_joints(effect.joints)}" if effect.joints else ""
        if verdict:
            yield f"The effect {effect.id}{where} is {verdict}."
        if effect.claim is not None and effect.claim.said == "class" and effect.physical_class is not None:
            others = [*(effect.physical_class.members or []), *(effect.physical_class.outside or [])]
            yield f"What these rows show is no more than: {effect.claim.words}. It may be any of {', '.join(others)}."
        alike = [one.id for one in effect.alias_set or []]
        if alike:
            yield f"These rows cannot tell {effect.id}{where} from {', '.join(alike)}: either would explain them."
    for one in (search.not_testable if search is not None else None) or []:
        why = (one.reason or "these rows do not show it").rstrip(".")
        remedy = f" Remedy: {one.remedy.rstrip('.')}." if one.remedy else ""
        yield f"{one.id} could not be tested: {why}.{remedy}"
