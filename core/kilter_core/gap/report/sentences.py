"""Sentences of the findings of a search, by their code."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from kilter_core.errors import Finding, Sentences

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
        f"(95 %: within {said['u95_mm']:.1g} mm) at the tool on average{_rotation_phrase(said)}. {_remedy(said)}"
    )


def _rotation_phrase(said: Mapping[str, Any]) -> str:
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


def _no_load(said: Mapping[str, Any]) -> str:
    return (
        f"{', '.join(said['effects'])} were not looked for: they follow load moments, and neither link masses nor a payload "
        "are known. Give the robot's links mass_kg and com_mm, or the rows payload_kg, and search again."
    )


def _no_next_poses(said: Mapping[str, Any]) -> str:
    return (
        "No poses are proposed: the contact decides which poses the arm can take. To make a name surer, hold the "
        "ball in more placements, with joint angles and orientations that differ from those measured."
    )


def _at_end_of_range(said: Mapping[str, Any]) -> str:
    size = f"{said['value']:.3g}" if said["unit"] == "1" else f"{said['value']:.3g} {said['unit']}"
    return (
        f"{said['parameter']} would come out beyond what is physical and is held at {size}: something else is in it. "
        "Check units, masses and payloads, and search again with `effects` that leave it out."
    )


def _not_settled(said: Mapping[str, Any]) -> str:
    return (
        f"The version leaves out what is not settled: {', '.join(said['names'])}. To settle it, measure more poses, revisit "
        "some at other times, or measure all in random order."
    )


SENTENCES: Sentences = {
    "moved_once": _moved_once,
    "unseen_stays_nominal": _unseen_stays_nominal,
    "no_load": _no_load,
    "no_next_poses": _no_next_poses,
    "at_end_of_range": _at_end_of_range,
    "not_settled": _not_settled,
}


def documents(findings: Iterable[Finding | dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Return findings of a search as they are stored and sent; documents of others as they are."""
    return (one.to_document(SENTENCES) if isinstance(one, Finding) else one for one in findings)
