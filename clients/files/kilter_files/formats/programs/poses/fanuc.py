"""FANUC's positions in X, Y, Z, W, P, R: their frames by number, and the configuration."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import NUMBER, Program, line_number
from kilter_files.formats.programs.notations import FANUC, Frame
from kilter_files.formats.programs.one_target import PoseTarget, Span, Use
from kilter_files.formats.programs.poses.configurations import Config
from kilter_files.formats.programs.poses.fanuc_frames import parse_frame_settings
from kilter_files.formats.programs.poses.track import frame_on_track

NULL = Frame(FANUC, (0.0,) * 6)
PART = re.compile(rf"\b([XYZWPR]|E\d)\s{{0,9}}=\s{{0,9}}({NUMBER})\s{{0,9}}(mm|deg)")
FRAME_NUMBER = re.compile(r"\b(UF|UT)\s?:\s{0,9}(\w{1,3})")
TURN = r"\s{0,9}(-?\d)\s{0,9}"
CONFIG = re.compile(rf"\bCONFIG\s?:\s?'\s{{0,9}}([NF])\s{{1,9}}([UD])\s{{1,9}}([TB])\s{{0,9}},{TURN},{TURN},{TURN}'")
TRACKS = re.compile(r"^[ \t]*+LINE_TRACK_SCHEDULE(?:_NUMBER)?\s*+:\s*+0*[1-9]", re.I | re.M)
OFFSET = re.compile(r"\b(?:Offset|Tool_Offset|INC|VOFFSET)\b", re.I)
NOT_TAUGHT = re.compile(r"=\s{0,9}\*{3,}")  # what a controller writes of a position that nobody taught
OTHER_FRAME = re.compile(r"\b(?:RTCP|COORD)\b", re.I)


def parse_pose_target(program: Program, number: str, at: int, span: Span) -> PoseTarget:
    """Read position ``number``, which begins at ``at``; ``span`` holds what its first motion group says."""
    text = program.text
    parts = {match[1]: match for match in PART.finditer(text, *span)}
    missing = [name for name in FANUC.names if name not in parts]
    config = CONFIG.search(text, *span)
    problem = f"without {', '.join(missing)}" if missing else "" if config else "its CONFIG is not understood"
    problem = "it is not taught (********)" if NOT_TAUGHT.search(text, *span) else problem
    axes = {name: float(match[2]) for name, match in parts.items() if name[0] == "E"}
    root, why = frame_on_track(program.stated, FANUC, axes)
    problem = problem or why
    if TRACKS.search(text):
        problem = problem or "it moves with what the program tracks (LINE_TRACK)"
    whole = [parts[name] for name in FANUC.names if name in parts]
    numbers = tuple(float(match[2]) for match in whole)
    pose = PoseTarget(
        f"P[{number}]", line_number(text, at), FANUC, numbers, tuple(match.span(2) for match in whole), problem=problem
    )
    pose.whole, pose.root = span, root
    if config is not None:
        turns = (int(config[4]), int(config[5]), int(config[6]))
        spans = (config.span(4), config.span(5), config.span(6))
        pose.configuration = Config(config[1] == "F", config[2] == "U", config[3] == "T", turns, spans)
    named = {match[1]: match[2] for match in FRAME_NUMBER.finditer(text, *span)}
    base, tool = (_frame(program, which, named.get(short)) for which, short in (("base", "UF"), ("tool", "UT")))
    pose.uses.append(Use(base if isinstance(base, str) else (base,), tool))
    return pose


def _frame(program: Program, which: str, number: str | None) -> Frame | str:
    """The frame of a number: the one that the program sets, else the stated one."""
    stated = program.stated.bases if which == "base" else program.stated.tools
    found = stated.get(number or "") or stated.get("")
    name = "UFRAME" if which == "base" else "UTOOL"
    settings = [one for one in parse_frame_settings(program.text) if one.name == name and one.number in (number, "")]
    if settings:
        one = settings[0]
        if len(settings) > 1 or not one.first or not one.number:
            return f"the program sets {name}: set it once, by a register filled with six numbers before any move"
        if one.numbers is None and found is None:
            return f"the program sets {name}[{number}] by numbers it does not hold: state it, --{which} {number}=X,Y,Z,W,P,R"
        found = one.numbers or found
    if found is not None:
        return Frame(FANUC, found)
    if number == "0":
        return NULL
    said = f"{'UF' if which == 'base' else 'UT'} : {number or '?'}"
    return f"{said} is not in this program: state it, --{which} {number or ''}{'=' if number else ''}X,Y,Z,W,P,R"
