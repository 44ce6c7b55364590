"""All commands: under which heading `kilter --help` lists them, the module that has them, and one line of what they do.

A command's module is imported when the command is called, so that each answers fast.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kilter_client.typed.option_texts import KINDS


@dataclass(frozen=True)
class Entry:
    """A command of the first level; ``module`` is the one of ``kilter_client.cli`` that registers it, with its folder."""

    module: str
    summary: str


WRITTEN: Mapping[str, Mapping[str, Entry]] = {
    "Measure": {
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
        "plan": Entry("plans", "Plan poses to measure, or those of a check."),
        "instrument": Entry("stored.instruments", "Add and list instruments and their certificates."),
        "suspicious": Entry("suspicious", "Name the rows of a campaign that look wrong."),
        "columns": Entry("lists", "List the columns of measurements and their units."),
        "formats": Entry("lists", "List the files that can be read."),
    },
    "Identify": {
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
    },
    "Versions": {
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
    },
    "Correct": {
        "correct": Entry("correction.correct", "Correct a trajectory with the active version."),
        "filter": Entry("correction.filtered", "Correct the joint targets of a robot program."),
        "bridge": Entry("correction.bridge", "Correct an arm between its controller and its drives."),
        "stream-session": Entry("access", "Print the keys of a session of a stream."),
    },
    "Robots": {
        "robot": Entry("robot.robots", "Add, list, show, check, convert and retire robots."),
        "mesh": Entry("robot.meshes", "Give links their shapes, for the picture of the arm."),
        "presets": Entry("lists", "List the robots that ship with Kilter."),
    },
    "Server": {
        "whoami": Entry("access", "Show who one is to the server, and in which role."),
        "login": Entry("access", "Print a link that logs a browser in, once."),
        "token": Entry("access", "Make, list and revoke tokens."),
        "audit": Entry("access", "Show who changed what, and check that record."),
        "status": Entry("correction.correct", "Show whether the server is ready."),
    },
}

_NAMES = frozenset(name for entries in WRITTEN.values() for name in entries)
# Kinds of job for which no command is written, by the command that is made of their declaration.
KINDS_BY_COMMAND: Mapping[str, str] = {name: kind for kind in KINDS if (name := kind.replace("_", "-")) not in _NAMES}
MADE = {name: Entry("of_kinds", KINDS[kind].summary) for name, kind in KINDS_BY_COMMAND.items()}
CATALOGUE: Mapping[str, Mapping[str, Entry]] = {
    heading: {**entries, **(MADE if heading == "Identify" else {})} for heading, entries in WRITTEN.items()
}
ENTRIES: Mapping[str, Entry] = {name: entry for listed in CATALOGUE.values() for name, entry in listed.items()}
