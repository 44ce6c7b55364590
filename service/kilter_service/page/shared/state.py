"""How a robot stands, in a word and a sentence: good, drifting, changed, not corrected, or not known."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_service.contract.drift import DriftSummary
from kilter_service.contract.today import Today
from kilter_service.page.shared.accuracy import Accuracy
from kilter_service.page.shared.correcting import OFF, Correcting
from kilter_service.page.words import format_in_largest_unit
from kilter_service.versions.today.sentences import ago


@dataclass(frozen=True)
class State:
    """``look`` is the colour's: good, warn, bad or faint."""

    word: str
    look: str
    sentence: str


def assess_robot_state(
    today: Today | None, accuracy: Accuracy | None, drift: DriftSummary | None, seen: Correcting
) -> State:
    """Say how a robot stands; what is worst is said."""
    if today is None or today.version_id is None:
        if seen.instead in ("", OFF):
            return State(OFF, "warn", today.sentences[0] if today is not None else "")
        return State(seen.instead, seen.look, seen.sentence)
    if seen.instead:
        return State(seen.instead, seen.look, seen.sentence)
    if drift is not None and drift.state in ("moved", "cannot_tell"):
        return State("Has moved", "bad", _without_word(drift.sentence))
    if today.changed:
        more = format_in_largest_unit(today.larger_by_mm, None if accuracy is None else accuracy.widest)
        said = f"Its error is {more} larger than at the fit, more than chance explains."
        return State("Has changed", "bad", said)
    if drift is not None and drift.state == "creeping":
        return State("Drifting", "warn", _without_word(drift.sentence))
    if accuracy is None:
        return State("Not known", "warn", "The active version was made without measurements of the tool.")
    if not accuracy.held_out:
        return State("Not known", "warn", "Nothing was held out of the fit, so its error looks too good.")
    if drift is None or drift.state == "never":
        return State("Good", "good", "As good as at its fit, as far as is known: it was not checked since.")
    when = (
        ""
        if drift.last is None or drift.age_days is None
        else f", last on {drift.last.at:%Y-%m-%d}, {ago(drift.age_days)}"
    )
    return State("Good", "good", f"Its checks agree with the active version{when}.")


def _without_word(sentence: str) -> str:
    """The sentence of a check without the word of its verdict, which stands beside it."""
    said = sentence.partition(": ")[2] or sentence
    return f"{said[:1].upper()}{said[1:]}"
