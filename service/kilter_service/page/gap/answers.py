"""The questions that a gap search answers, each in a sentence and with the place where its evidence is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kilter_service.contract.jobs.gap import GapResult
from kilter_service.ground.texts import plural
from kilter_service.page.gap.claim import LEVELS
from kilter_service.page.shared.called import format_claim
from kilter_service.page.words import joined_by_and, number

ORDER = tuple(LEVELS)
NO_EFFECT = {
    "unexplained": "Something is left, and no effect of the library explains it.",
    "not_known": "Not known: without repeats no noise is known apart from the fit.",
}


@dataclass(frozen=True)
class Answer:
    """A question, its answer, and the section that holds the evidence."""

    question: str
    answer: str
    section: str


def answers(result: GapResult) -> list[Answer]:
    """Answer what people ask of a search."""
    return [
        Answer("Which effect is missing?", _answer_missing_effect(result), "effects"),
        Answer("Is it sure?", _answer_certainty(result), "sure"),
        Answer("What do I measure next?", _answer_next_poses(result), "next"),
        Answer("Which rows were set aside?", set_aside(result), "set-aside"),
        Answer("What can these data not tell?", _limits(result), "limits"),
    ]


def _answer_missing_effect(result: GapResult) -> str:
    effects = result.effects or []
    if not effects:
        return NO_EFFECT.get(result.verdict or "", "None: nothing exceeds the noise.")
    said = []
    for effect in effects:
        amounts = ", ".join(
            f"{number(p.value)} {'' if p.unit in (None, '1') else p.unit}".strip() for p in effect.parameters or []
        )
        said.append(f"{format_claim(effect)} ({amounts})")
    return f"{joined_by_and(said)}."


def _answer_certainty(result: GapResult) -> str:
    levels = [effect.verdict or "provisional" for effect in result.effects or []]
    if not levels:
        detectable = len({one.id for one in result.smallest_detectable or []})
        return (
            f"Nothing is claimed. {plural(detectable, 'effect')} of the library would have been seen if large enough."
        )
    lowest = min(levels, key=lambda level: ORDER.index(level) if level in ORDER else 0)
    head = {"contradicted": "No", "provisional": "Not yet", "class_confirmed": "Its kind is"}.get(lowest, "Yes")
    return f"{head}: {lowest.replace('_', ' ')}. {LEVELS.get(lowest, '')}"


def _answer_next_poses(result: GapResult) -> str:
    poses = result.next_poses or []
    if poses:
        changes = list(dict.fromkeys(pose.change or "new poses" for pose in poses))
        pair = " from ".join(poses[-1].separates or [])
        tell = f", to tell {pair.replace('_', ' ')}" if pair else ""
        return f"{plural(len(poses), 'pose')}{tell}: {'; '.join(changes)}."
    if any(effect.verdict == "class_confirmed" for effect in result.effects or []):
        return "Nothing: no pose that the search tried tells the aliases apart. Look at the joint itself."
    if result.effects:
        return "Nothing that would decide between candidates; a campaign on another day would confirm what was named."
    return "Nothing is proposed, because nothing was named that poses could make surer."


def set_aside(result: GapResult) -> str:
    """Say how many visits took no part in the search."""
    return f"{' '.join(_aside(result)) or 'The search set none aside: every visit took part.'}"


def _aside(result: GapResult) -> Iterator[str]:
    for warning in result.warnings or []:
        if warning.code == "outliers" or warning.visits or warning.rows:
            yield warning.message
    held = (result.gap.held_out_set_aside if result.gap is not None else None) or 0
    if held:
        every = result.gap.validation_after_all_mm if result.gap is not None else None
        with_them = "" if every is None else f"; with them the error after is {number(every, 4)} mm"
        yield f"{plural(held, 'held-out visit')} no model of this search predicts, left out of its errors{with_them}."
    told, fit = result.predictive, None if result.adequacy is None else result.adequacy.held_out
    if told is not None and told.of_all:
        yield (
            f"Of held-out coordinates {told.inside} of {told.of} are within their 95 % intervals; with what was set aside "
            f"{told.inside_all} of {told.of_all}."
        )
    if fit is not None and fit.freedom_all:
        yield (
            f"Their chi-square is {number(fit.chi2)} for {fit.freedom} numbers; with what was set aside "
            f"{number(fit.chi2_all)} for {fit.freedom_all}."
        )


def _limits(result: GapResult) -> str:
    names = list(dict.fromkeys(row.id.replace("_", " ") for row in result.not_testable or []))
    library = "Nothing that is outside the library can be excluded."
    if not names:
        return f"Every effect of the search could be tested. {library}"
    shown = joined_by_and(names[:4]) if len(names) <= 4 else f"{', '.join(names[:4])} and {len(names) - 4} more"
    return f"Whether there is {shown}: these rows do not vary what they depend on enough. {library}"
