"""How a robot stands as its views say it: what its answer says of the arm, unless what corrects it is worse."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_service.contract.today import Standing, Today
from kilter_service.page.shared.correcting import OFF, TWICE, Correcting

LOUDNESS = ("bad", "warn", "faint", "good")


@dataclass(frozen=True)
class State:
    """``look`` is the colour's: good, warn, bad or faint."""

    word: str
    look: str
    sentence: str


def assess_robot_state(today: Today, seen: Correcting) -> State:
    """Say how a robot stands; what is worst is said."""
    standing = today.standing or Standing(state="not_known", words="Not known", sentence="", look="faint")
    instead = bool(seen.instead) and not (standing.state == "uncalibrated" and seen.instead == OFF)
    if seen.instead == TWICE or (instead and standing.look != "bad"):
        return State(seen.instead, seen.look, seen.sentence)
    return State(standing.words, standing.look, standing.sentence)
