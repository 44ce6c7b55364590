"""All commands: the few that `kilter --help` lists, the groups that hold the others, and what each does in one line.

A command's module is imported when the command is called, so that each answers fast.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kilter_client.typed.option_texts import KINDS


@dataclass(frozen=True)
class Entry:
    """A command; ``module`` is the one of ``kilter_client.cli`` that registers it, with its folder."""

    module: str
    summary: str


@dataclass(frozen=True)
class Group:
    """A group of the first level: the ``commands`` in it, by the word behind the group's.

    It holds the commands of ``own`` too, which is a group itself. ``by_default`` may be left out.
    """

    summary: str
    commands: Mapping[str, str]
    own: str = ""
    by_default: str = ""


WRITTEN: Mapping[str, Entry] = {
    "try": Entry("trial", "Find what a model lacks from a file, without a server."),
    "demo": Entry("trial", "Calibrate and correct a simulated arm, without a server."),
    "upload": Entry("files.upload", "Send measurements of a robot; they become a campaign."),
    "campaigns": Entry("stored.campaigns", "List, name, retire and purge campaigns."),
    "inspect": Entry("files.inspect", "Show how a file is read; nothing is sent."),
    "match": Entry("files.match", "Join a recording of markers with a joint log."),
    "episodes": Entry("files.episodes", "Name joints that moved within a LeRobot data set."),
    "board": Entry("camera.board", "Write a board to print for a camera."),
    "see": Entry("camera.see", "Find boards in pictures and write their corners as rows."),
    "live": Entry("camera.live", "Show a camera's picture and take views at rest."),
    "sheet": Entry("files.sheet", "Write the sheet to print for measuring with a pencil."),
    "sheet-read": Entry("files.sheet", "Read a scan or photo of a drawn sheet."),
    "sheet-join": Entry("files.sheet", "Join a drawn sheet and the height with the joint log."),
    "ballbar-join": Entry("files.joins", "Join a ball bar's log with the joint log."),
    "tilt-join": Entry("files.joins", "Join an inclinometer's log with the joint log."),
    "plan": Entry("plans", "Plan poses to measure, those of a check, or motions."),
    "instrument": Entry("stored.instruments", "Add and list instruments and their certificates."),
    "suspicious": Entry("suspicious", "Name the rows of a campaign that look wrong."),
    "columns": Entry("lists", "List the columns of measurements and their units."),
    "formats": Entry("lists", "List the files that can be read."),
    "identify": Entry("analyse", "Identify parameters from campaigns; makes a version."),
    "gap": Entry("analyse", "Find and name what the model lacks; makes a version."),
    "evaluate": Entry("analyse", "Compare a version with a campaign."),
    "kit": Entry("camera.kit", "Take a low-cost arm from views to one page."),
    "hand-eye": Entry("camera.hand_eye", "Find where cameras stand on a robot, and export it."),
    "check": Entry("drift", "Say whether an arm has moved since its version."),
    "drift": Entry("drift", "Show the checks of a robot, or how all robots stand."),
    "repair": Entry("drift", "Record what was done to an arm, and when."),
    "rezero": Entry("drift", "Make a version of what moved, and nothing else."),
    "joint-parameters": Entry("joints", "Measure clearance, backlash and stiffness directly."),
    "fleet": Entry("fleet", "Identify many robots anew, and show what came out."),
    "jobs": Entry("jobs", "List, show, watch and cancel jobs."),
    "effects": Entry("lists", "List the physical effects that can be identified."),
    "methods": Entry("lists", "List the methods of an identification."),
    "versions": Entry("stored.versions", "List, name, retire and purge versions."),
    "version": Entry("stored.versions", "Show a version: where it comes from, its parameters."),
    "activate": Entry("stored.versions", "Make a version the one that corrects."),
    "rollback": Entry("stored.versions", "Return to the version that was active before."),
    "accept": Entry("accept", "Decide by ISO 14253-1 whether an arm keeps a tolerance."),
    "today": Entry("stored.versions", "Show how good a robot is today, and what is missing."),
    "activations": Entry("stored.versions", "List who activated which version, when and why."),
    "diff": Entry("stored.versions", "Compare the parameters of two versions."),
    "residuals": Entry("residuals", "Write the residual of every measured row."),
    "export": Entry("stored.versions", "Write a version as a file for other programs."),
    "twin": Entry("correction.twin", "Score or calibrate a simulator's model."),
    "homing": Entry("correction.homing", "Put zero offsets into a copy of LeRobot's calibration."),
    "correct": Entry("correction.correct", "Correct a trajectory with the active version."),
    "filter": Entry("correction.filtered", "Correct the joint targets of a robot program."),
    "bridge": Entry("correction.bridge", "Correct an arm between its controller and its drives."),
    "torque": Entry("correction.torque", "Tell the torques that a path needs."),
    "stream-session": Entry("access", "Print the keys of a session of a stream."),
    "robot": Entry("robot.robots", "Add, list, show, check, convert and retire robots."),
    "mesh": Entry("robot.meshes", "Give links their shapes, for the picture of the arm."),
    "presets": Entry("lists", "List the robots that ship with Kilter."),
    "whoami": Entry("access", "Show who one is to the server, and in which role."),
    "login": Entry("access", "Print a link that logs a browser in, once."),
    "token": Entry("access", "Make, list and revoke tokens."),
    "audit": Entry("access", "Show who changed what, and check that record."),
    "status": Entry("correction.correct", "Show whether the server is ready."),
}

# Kinds of job for which no command is written, by the command that is made of their declaration.
WRITTEN_ELSEWHERE = frozenset({"motion-plan"})  # kilter plan motion
KINDS_BY_COMMAND: Mapping[str, str] = {
    name: kind for kind in KINDS if (name := kind.replace("_", "-")) not in WRITTEN_ELSEWHERE.union(WRITTEN)
}
MADE = {name: Entry("of_kinds", KINDS[kind].summary) for name, kind in KINDS_BY_COMMAND.items()}
ENTRIES: Mapping[str, Entry] = {**WRITTEN, **MADE}


def _by_own_names(*names: str) -> dict[str, str]:
    return {name: name for name in names}


GROUPS: Mapping[str, Group] = {
    "robot": Group(
        "Add, list, show and check robots; presets, shapes, kits, fleets.",
        _by_own_names("presets", "mesh", "torque", "kit", "homing", "episodes", "fleet"),
        own="robot",
    ),
    "version": Group(
        "Show, list, compare, export and judge versions.",
        {
            "show": "version",
            **_by_own_names("diff", "evaluate", "residuals", "export", "twin", "accept", "rollback", "activations"),
        },
        own="versions",
        by_default="show",
    ),
    "measure": Group(
        "Read files, join logs, print boards and sheets; campaigns.",
        _by_own_names(
            "campaigns",
            "inspect",
            "match",
            "suspicious",
            "instrument",
            "columns",
            "formats",
            "board",
            "see",
            "live",
            "sheet",
            "sheet-read",
            "sheet-join",
            "ballbar-join",
            "tilt-join",
            "joint-parameters",
            "payload",
            "hand-eye",
        ),
    ),
    "watch": Group("Follow checks, note repairs, re-zero what moved.", _by_own_names("drift", "repair", "rezero")),
    "server": Group(
        "Jobs, tokens, logins and the audit of a server; its lists.",
        _by_own_names(
            "status",
            "jobs",
            "token",
            "login",
            "whoami",
            "audit",
            "stream-session",
            "demo",
            "effects",
            "methods",
        ),
    ),
}
# What `kilter --help` shows, in the order of use.
FIRST = (
    "robot",
    "upload",
    "identify",
    "gap",
    "activate",
    "correct",
    "check",
    "today",
    "plan",
    "filter",
    "bridge",
    "try",
    "version",
    "measure",
    "watch",
    "server",
)
UNLISTED = ("demo",)  # on the first level, too, where it does not stand
# Where a command is that stood on the first level before; it works there for one release more.
MOVED: Mapping[str, str] = {
    old: f"{name} {new}"
    for name, group in GROUPS.items()
    for new, old in group.commands.items()
    if old not in FIRST + UNLISTED
} | {"versions": "version"}
SUMMARIES: Mapping[str, str] = {
    name: GROUPS[name].summary if name in GROUPS else ENTRIES[name].summary
    for name in (*FIRST, *(one for one in MADE if one not in MOVED))
}
