"""What helps where a target is left: one remedy for each reason. Reasons that say what to state have theirs in themselves."""

from __future__ import annotations

import re
from collections.abc import Iterable

AS_JOINTS = "Store it as joints: a controller shows them where the arm stands."
MOVE_BEFORE = "Move to joints near the pose before it, or state its configuration."
OWN_TARGET = "Declare a target of its own for each."
OWN_NAME = "Give each target a name of its own."
PLAIN_NUMBERS = "Write the target with numbers."
SET_BEFORE = "Set base and tool in the routine, before the move and outside its branches."
# what a reason says, as a text or a pattern, and what helps then; the first that fits
REMEDIES: tuple[tuple[str | re.Pattern[str], str], ...] = (
    ("is beyond its limit", "Teach these targets within reach."),
    ("is held at its limit", "Teach these targets further from the limit."),
    ("DAMPED", "Teach these targets further from the singularity."),
    (
        "out of reach",
        "Check that robot, base and tool are those of the program: kilter robot check shows the arm at zero.",
    ),
    (
        "have its configuration",
        "Compare its zero, limits and signs with the controller's: kilter robot check, --signs.",
    ),
    ("several joints reach it", AS_JOINTS),
    ("past a singularity", AS_JOINTS),
    ("singularity", AS_JOINTS),
    ("the target from which the arm comes is not known", MOVE_BEFORE),
    ("follow those of the target before it", MOVE_BEFORE),
    ("too far from the target before it", MOVE_BEFORE),
    ("moves come to it with different joints", OWN_TARGET),
    ("different frames or tools", OWN_TARGET),
    ("declared several times", OWN_NAME),
    ("is not beside it", "Copy the .dat beside the .src, and filter them together."),
    ("depends on the way", SET_BEFORE),
    ("sets its", SET_BEFORE),
    ("behind it may set", SET_BEFORE),
    ("is set after it", SET_BEFORE),
    ("changes $", SET_BEFORE),
    ("is set several times", SET_BEFORE),
    ("displaces it", AS_JOINTS),
    (
        "orientation is not kept",
        "Keep the orientation of the target in the move ($ORI_TYPE=#VAR, mode 0, SingArea \\Wrist).",
    ),
    ("stands still", AS_JOINTS),
    ("moves, or its tool", AS_JOINTS),
    ("tracks", AS_JOINTS),
    ("sensor", "Filter the program without what the sensor moves, or move to its target without the sensor too."),
    ("force_mode", "Move to it without force_mode too."),
    ("have an offset", "Move to it without the offset too."),
    ("changes it", OWN_TARGET),
    ("may change", "Declare it CONST, or give the routine a copy."),
    ("is given it", "Filter the program that moves to it, or move to it here."),
    ("no move of the program goes to it", "Filter it with the program that moves to it, or delete it."),
    ("relative move", "Move to a target that is written out."),
    ("computed", PLAIN_NUMBERS),
    ("computes", PLAIN_NUMBERS),
    ("without numbers", PLAIN_NUMBERS),
    ("is not a number", PLAIN_NUMBERS),
    (
        re.compile(r"[( ][A-Za-z]\w*(?:\[\d+\])?: no[t]? ?a? ?target of this file"),
        "Filter the file that declares the target.",
    ),
    (re.compile(r"(?:Offs|RelTool|pose_\w+)\(.*target of this file|:\{.*target of this file"), PLAIN_NUMBERS),
    ("no position of this file", "Write a position of the program into the move."),
    ("not a unit quaternion", "Correct its four numbers: their squares add up to 1."),
    ("confdata is not understood", "Give four whole numbers, the last from 0 to 7."),
    ("CONFIG is not understood", "Export the position again with its CONFIG."),
    ("not taught", "Teach it, or delete it."),
    ("its inverse needs six", ""),  # says itself what to give
    ("corrected twice", "Do not filter what such a controller corrects."),
    ("does not state E", "State the axis in each pose, or --track with none."),
)
SAYS_IT = re.compile(": (?:state it|state a rail|write |set it|filter )")
MOST = 3


def remedies(reasons: Iterable[str]) -> list[str]:
    """Return the remedies of reasons, each once, in the order of the reasons; the most frequent kinds only."""
    found = [remedy for remedy in map(remedy_for_reason, dict.fromkeys(reasons)) if remedy]
    return [*dict.fromkeys(found)][:MOST]


def remedy_for_reason(reason: str) -> str:
    """Return what helps; empty where the reason says it itself, or nothing is known."""
    if SAYS_IT.search(reason):
        return ""
    return next(
        (remedy for said, remedy in REMEDIES if (said in reason if isinstance(said, str) else said.search(reason))), ""
    )
