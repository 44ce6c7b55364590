"""Sentences of the findings of a search, by their code."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_core.errors import Sentences

CALLED = {"base_step": "The station (base or instrument)", "tool_step": "The tool, its marker or its nest"}
SEEN = {
    "base_step": "The base, or the camera or board in the room",
    "tool_step": "The tool, or the camera or board on the flange",
}
SESSION = "Give the rows from there on a session of their own: "
REMEDIES = {
    "base_step": f"{SESSION}with --refit base every session has a base of its own.",
    "tool_step": f"{SESSION}with --refit tool every session has a tool of its own.",
}
OF_THE_ARM = "It is the arm's from there on: a correction takes the last."


def _moved_once(said: Mapping[str, Any]) -> str:
    who = (SEEN if said["by_views"] else CALLED).get(said["effect"], f"The zero of joint {said['joint']}")
    verb = "may have moved" if said["likely"] else "moved"
    low, high = said["rows_95"]
    sure = "" if low == high == said["row"] else f" (95 %: the first row after it is {low} to {high})"
    return (
        f"{who} {verb} between rows {said['before']} and {said['row']}{sure}, by {said['moved_mm']:.3g} mm "
        f"(95 %: within {said['u95_mm']:.1g} mm) at the tool on average{_rotated(said)}. {_remedy(said)}"
    )


def _rotated(said: Mapping[str, Any]) -> str:
    if not said["moves_frame"]:
        return ""
    if said["rotated_deg"] is None:
        return " (one point of it was measured, which shows no rotation)"
    return f" and {said['rotated_deg']:.2g} deg (within {said['u95_deg']:.1g} deg)"


def _remedy(said: Mapping[str, Any]) -> str:
    if not said["moves_frame"]:
        return OF_THE_ARM
    if not said["by_views"]:
        return REMEDIES[said["effect"]]
    named = f"If {said['part']} {said['name']} moved, give it" if "part" in said else "Give that camera or board"
    return f"{named} another name from there on: each place is then fitted by itself."


def _unseen_stays_nominal(said: Mapping[str, Any]) -> str:
    where = ("joint " if len(said["joints"]) == 1 else "joints ") + ", ".join(map(str, said["joints"]))
    remedy = f"{said['remedy'][:1].lower()}{said['remedy'][1:]}"
    return (
        f"{said['effect']} is not shown at {where}: it stays nominal there, and the version stores nothing of it. "
        f"To find it there: {remedy}"
    )


SENTENCES: Sentences = {"moved_once": _moved_once, "unseen_stays_nominal": _unseen_stays_nominal}
