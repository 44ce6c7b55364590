"""Lines of KRL: which are known to leave joint targets alone; every other is named.

Patterns that a long text is searched for fast: ones that begin with known words, and ones of brackets in brackets.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from functools import lru_cache

STATEMENTS = """
DEF DEFFCT DEFDAT END ENDFCT ENDDAT GLOBAL PUBLIC DECL CONST EXT EXTFCT EXTP EXTFCTP IMPORT STRUC ENUM SIGNAL
INT REAL BOOL CHAR POS E6POS AXIS E6AXIS FRAME IF ELSE ENDIF FOR ENDFOR WHILE ENDWHILE REPEAT UNTIL LOOP ENDLOOP
SWITCH CASE DEFAULT ENDSWITCH EXIT GOTO RETURN CONTINUE HALT WAIT INTERRUPT BRAKE RESUME TRIGGER PULSE ANIN ANOUT
COPEN CCLOSE CREAD CWRITE SREAD SWRITE SPLINE PTP_SPLINE ENDSPLINE TIME_BLOCK CONST_VEL STOP
"""
KEPT = frozenset(STATEMENTS.split())
WORD = re.compile(r"\w{1,64}")
LABEL = re.compile(r"\w{1,64}\s{0,9}:\s{0,9}")
CALL = re.compile(r"\w{1,64}\s{0,9}\(.{0,1000}\)\s{0,9}")
PLACE = re.compile(
    r"(?:DECL\s{1,9}|GLOBAL\s{1,9}|(?:E6)?AXIS\s{1,9}){0,3}(\$?\w{1,64}+)([\w.\[\],+\- \t]{0,100}+)=(?!=)",
    re.I,
)
MOTIONS = r"(?:S?(?:PTP|LIN|CIRC)(?:_REL)?|SPL)"
MOTION = re.compile(MOTIONS, re.I)
INNER = re.compile(rf"(?<![\w#$.]){MOTIONS}\s{{1,9}}[\w{{]", re.I)
CALLED = re.compile(r"(?<![\w.$])(\w{1,64})\s{0,9}\(([^()]{1,1000})\)")
HANDED = re.compile(r"(?<![\w.#$])(\w{1,64})(?:\[[\d,]{1,9}\])?(?!\w|\s{0,9}[.(])")
PART_HANDED = re.compile(r"(?<![\w.#$])(\w{1,64})(?:\[[\d,]{1,9}\])?[ \t]*+\.[ \t]*+(?:[XYZABCST]|A\d)(?![\w.])", re.I)
OF_MOTION = re.compile(
    r"S(?:TOOL2?|BASE|IPO_MODE|LOAD|(?:VEL|ACC|APO|GEAR|ORI|CIRC)_?\w{0,20}|JERK)|USE_CM_PRO_VALUES|E[BK]", re.I
)
READING = frozenset(("CREAD", "SREAD"))  # give what they are handed another value
AXIS_PART = re.compile(r"\.\s{0,9}A\d\s{0,9}\Z", re.I)
LIST = re.compile(r"\s{0,9}\{")
GIVEN = re.compile(
    r"^[ \t]*+(\w{1,64}+)([\w.\[\],+\- \t]{0,100}+)=(?!=)(?![ \t]*+\{[^{}\r\n]{0,500}\}[ \t]*+\r?$)", re.I | re.M
)
SENSOR = re.compile(r"\b(?:RSI_(?:ON|MOVECORR)|ST_(?:MOVESENS|ON1?))[ \t]*+\(", re.I)
EXTERNAL_PART = re.compile(r"\s*+\.\s*+E\d", re.I)
RELATIVE = re.compile(r"^[ \t]*+S?(?:PTP|LIN|CIRC)_REL[ \t]+(\w{1,64})", re.I | re.M)
PART_READ = re.compile(
    r"(?<![\w$.])(\w{1,64})(?:[ \t]*+\[[^\]\r\n]{0,60}\])?[ \t]*+\.[ \t]*+A\d\b(?![ \t]*+=(?!=))", re.I
)
SUBPROGRAM = re.compile(r"^[ \t]*+(?:\w{1,64}[ \t]*+=[ \t]*+)?(\w{1,64})[ \t]*+\(", re.M)
REST = frozenset(
    ("BAS", "ABS", "SQRT", "SIN", "COS", "TAN", "ACOS", "ATAN2", "INV_POS", "INVERSE", "FORWARD")
)  # never move


def reassigned_or_passed_variables(text: str) -> set[str]:
    """Return the variables, in capitals, that a statement gives another value than a list, or hands to a subprogram."""
    found = {match[1].upper() for match in GIVEN.finditer(text) if not EXTERNAL_PART.match(match[2])}
    calls = {text[at : text.find("\n", at) % (len(text) + 1)] for at in subprograms(text)}
    return found | {one[1].upper() for call in calls for one in HANDED.finditer(call.partition("(")[2])}


def used_as_data(text: str) -> set[str]:
    """Return the variables, in capitals, that are the amount of a relative motion, or of which an axis is read."""
    return {match[1].upper() for pattern in (RELATIVE, PART_READ) for match in pattern.finditer(text)}


def subprograms(text: str) -> list[int]:
    """Return where statements call subprograms, of this file or of others: they may move the arm."""
    return [match.start() for match in SUBPROGRAM.finditer(text) if match[1].upper() not in KEPT | REST]


def not_kept(
    text: str, targets: Collection[str], poses: Collection[str], within: Collection[int]
) -> Iterator[tuple[int, str]]:
    """Yield line number and reason for each line that may move the arm elsewhere and is not a motion to a target.

    ``text`` has its comments blanked; ``targets`` and ``poses`` are names of joint targets and of poses in capitals,
    ``within`` the starts of lines that are the inside of a list of axes.
    """
    bases = {name.partition("[")[0] for name in targets}
    handed = bases | {name.partition("[")[0] for name in poses}
    at, known = 0, dict[str, str]()  # what a line does stands in it, however often it comes
    for number, line in enumerate(text.split("\n"), 1):
        said = line.strip()
        if said and said[0] != "&" and at not in within:  # & begins what only the editor reads
            if said not in known:
                known[said] = _describe_line(said, bases, handed)
            if known[said]:
                yield number, f"{said[:40]}: {known[said]}"
        at += len(line) + 1


def _describe_line(said: str, bases: Collection[str], handed: Collection[str]) -> str:
    """Why a line may move the arm elsewhere than to a target; empty: it does not."""
    calls = "(" in said
    why = "a sensor moves the arm" if calls and SENSOR.search(said) else ""
    why = why or _changes_target(said, bases) or _not_understood(said)
    return why or (_describe_passed_target(said, handed) if calls else "")


def _changes_target(said: str, bases: Collection[str]) -> str:
    found = PLACE.match(said)
    if found is None or found[1].upper() not in bases:
        return ""
    whole = "." not in found[2]
    listed = LIST.match(said, found.end()) is not None
    return f"changes the axis target {found[1]}" if (whole and not listed) or AXIS_PART.search(found[2]) else ""


def _describe_passed_target(said: str, targets: Collection[str]) -> str:
    """The subprogram that is given a target: it may move to it with other frames, or change it."""
    for call in CALLED.finditer(said):
        if call[1].upper() not in KEPT - READING and any(one[1].upper() in targets for one in HANDED.finditer(call[2])):
            return f"{call[1]} is given a target"
    return next((f"{by} is given a part of a target" for by, name in parts_handed(said) if name in targets), "")


@lru_cache(maxsize=4)
def _calls_that_may_change(text: str) -> list[tuple[str, str]]:
    """The functions that may change what they are given, each once with all that it is given so."""
    calls = dict.fromkeys(CALLED.findall(text))
    return [call for call in calls if _may_change(call[0].upper())]


@lru_cache(maxsize=1024)
def _may_change(function: str) -> bool:
    """Whether a function, in capitals, may change what it is given."""
    return function in READING or (function not in KEPT | REST and OF_MOTION.fullmatch(function) is None)


def variables_passed_to_calls(text: str) -> set[str]:
    """Return the variables, in capitals, that a call is given whole or in part and may change; arrays without their index."""
    given = {said for _, said in _calls_that_may_change(text)}
    return {one[1].upper() for said in given for pattern in (HANDED, PART_HANDED) for one in pattern.finditer(said)}


def parts_handed(text: str) -> Iterator[tuple[str, str]]:
    """Yield what is given a part of a variable, which it may change, and the name of the variable in capitals."""
    for by, given in _calls_that_may_change(text):
        yield from ((by, one[1].upper()) for one in PART_HANDED.finditer(given))


def _not_understood(said: str) -> str:
    word = WORD.match(said)
    first = word[0].upper() if word else ""
    if MOTION.fullmatch(first):  # the target says whether it is rewritten
        return ""
    known = first in KEPT or any(form.fullmatch(said) for form in (LABEL, CALL)) or PLACE.match(said)
    return "" if known and not INNER.search(said) else "is not understood"


class Keyed:
    """A pattern whose matches begin at one of some words, in capitals or small letters; it finds what the pattern finds.

    The pattern begins with a condition that a word begins there, as ``\\b`` is. Python tries such a pattern, or one for
    capitals and small letters alike, at each place of a text, which takes up to a second for 16 MB.
    """

    def __init__(self, words: str, pattern: str, flags: int = re.I) -> None:
        """Take the words, in small letters and parted by blanks, and the pattern."""
        self._words, self._pattern = words.split(), re.compile(pattern, flags)

    def finditer(self, text: str) -> Iterator[re.Match[str]]:
        """Yield the matches that do not overlap, from left to right."""
        folded = _lower_text(text)
        words = "|".join(word for word in self._words if word in folded)
        end = 0
        for place in re.finditer(words, folded) if words else ():
            match = self._pattern.match(text, place.start()) if place.start() >= end else None
            if match is not None:
                yield match
                end = match.end()

    def search(self, text: str) -> re.Match[str] | None:
        """Return the first match."""
        return next(self.finditer(text), None)

    def match(self, text: str, at: int = 0) -> re.Match[str] | None:
        """Return the match at a place."""
        return self._pattern.match(text, at)


class Tailed:
    """A pattern of a head that may begin nearly anywhere, and a tail that does not; it finds what both together find.

    The tail begins with a sign, which Python finds fast. Only in front of a tail the head is looked for, which is no longer
    than ``REACH``; what follows the head does not depend on it.
    """

    REACH = 200  # characters

    def __init__(self, head: str, tail: str) -> None:
        """Take both; capitals count as small letters."""
        self._tail, self._whole = re.compile(tail, re.I), re.compile(head + tail, re.I)

    def finditer(self, text: str) -> Iterator[re.Match[str]]:
        """Yield the matches that do not overlap, from left to right."""
        end = 0
        for tail in self._tail.finditer(text):
            match = self._whole.search(text, max(end, tail.start() - self.REACH), tail.end())
            if match is not None:
                yield match
                end = match.end()


def has_word(text: str, *words: str) -> bool:
    """Say whether one of these words, in small letters, is anywhere in a text, in capitals or small letters."""
    folded = _lower_text(text)
    return any(word in folded for word in words)


@lru_cache(maxsize=2)
def _lower_text(text: str) -> str:
    """Small letters at the same places: programs are text of 8 bits, of which no letter becomes two."""
    return text.lower()


def nested(brackets: str, levels: int) -> str:
    """Return a pattern of text in which brackets close, at most so many in another."""
    opening, closing = (rf"[{re.escape(brackets[k::2])}]" for k in (0, 1))
    plain = rf"[^{re.escape(brackets)}]*+"
    inner = plain
    for _ in range(levels):
        inner = rf"{plain}(?:{opening}{inner}{closing}{plain})*+"
    return inner


ARGUMENT = re.compile(
    rf"\s*+([^\[\](){{}},]*+(?:[\[({{]{nested('()[]{}', 5)}[\])}}][^\[\](){{}},]*+)*+)(,|\Z)"
)  # as all that a person writes


def arguments(said: str) -> Iterator[tuple[int, str]]:
    """Yield the arguments of an instruction with their places: they part at the commas outside brackets.

    From where brackets do not close, or too many stand in another, the rest is one argument.
    """
    start = 0
    while (found := ARGUMENT.match(said, start)) is not None:
        yield found.start(1), found[1].rstrip()
        start = found.end()
        if not found[2]:
            return
    rest = said[start:]
    yield start + len(rest) - len(rest.lstrip()), rest.strip()
