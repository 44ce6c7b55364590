"""The way of a RAPID program: where one move surely follows another, and whether ConfL or ConfJ is off at a place."""

from __future__ import annotations

import re
from collections.abc import Sequence

from kilter_files.formats.programs.keyed import Keyed
from kilter_files.formats.programs.poses.in_force import InForce

SWITCHED = Keyed("conf", r"\bConf([JL])\s*+\\\s*+(On|Off)\b")
ROUTINE = Keyed("proc func trap", r"\b(?:PROC|FUNC\s+\w{1,64}|TRAP)\s+(\w{1,64})")
STARTS = re.compile(r"^[ \t]*+(?:LOCAL\s+)?(?:PROC|FUNC|TRAP|ERROR|UNDO|BACKWARD|END(?:PROC|FUNC|TRAP))\b", re.I | re.M)
STATEMENT = re.compile(r"(?:^[ \t]*+|(?:;|\b(?:THEN|ELSE|DO)\b|(?<=\w):(?!=))\s*+)([A-Za-z]\w{0,63})", re.I | re.M)
WAYS = {
    **dict.fromkeys(("IF", "WHILE", "FOR", "TEST"), 1),
    **dict.fromkeys(("ENDIF", "ENDWHILE", "ENDFOR", "ENDTEST"), -1),
    **dict.fromkeys(("ELSE", "ELSEIF", "CASE", "DEFAULT", "RETURN", "RAISE", "RETRY", "TRYNEXT", "EXITCYCLE"), 0),
    "GOTO": None,
}
LABEL = re.compile(r"^[ \t]*+(?!(?:CASE|DEFAULT)\b)[A-Za-z]\w{0,63}[ \t]*+:(?!=)", re.I | re.M)
# instructions, and words that begin a statement, after which the arm stands where it stood
STAYS = re.compile(
    r"(?:END)?(?:MODULE|RECORD|PROC|FUNC|TRAP)|LOCAL|TASK|VAR|PERS|CONST|ALIAS|ERROR|UNDO|BACKWARD|THEN|DO|TO|STEP|FROM"
    r"|AND|OR|XOR|NOT|DIV|MOD|TRUE|FALSE|CONNECT|WITH|NOSTEPIN|SYSMODULE|Conf[JL]|AccSet|VelSet|(?:Set|Pulse|Invert)[ADG]O"
    r"|Set|Reset|Wait(?:Time|DI|DO|GI|GO|AI|AO|Until|Rob|TestAndSet)|TP(?:Write|Erase|Read\w+|Show)|UIMsgBox|Incr|Decr|Add"
    r"|Clear|Clk(?:Start|Stop|Reset)|Err(?:Write|Log|Raise)|Open|Close|Write(?:Bin|StrBin)?|Rewind|SingArea|PathAccLim"
    r"|WorldAccLim|Soft(?:Act|Deact)|CirPathMode|CornerPathWarning|Trigg(?:IO|Equip|Int|Speed|CheckIO|RampAO)"
    r"|I(?:Enable|Disable|Watch|Sleep|Delete|Signal[DAG][IO]|Timer)|Socket(?:Create|Connect|Close|Send|Receive)|GripLoad|Stop"
    r"|Break|BookErrNo|SetSysData|MotionSup|Corr(?:Con|Write|Clear|Discon)|(?:Act|Deact)Unit"
    r"|EGM(?:GetId|Reset|Setup\w+|Act\w+|Stop)"
    r"|Move(?:Abs)?[JLC]?\w*|Arc[LC]\w*|Trigg[LJC]|Search[LC]",  # moves say themselves where they go
    re.I,
)
ASSIGNED = re.compile(r"\s*+(?:[.{][^;:]{0,200})?:=")
THEN = re.compile(r"\bTHEN\b", re.I)
LONGEST = 500  # characters of a short IF
UNKNOWN = "UNKNOWN"
Place = tuple[int, int | None]


class RapidFlow:
    """Ask what is known of a place; ``text`` has its comments blanked."""

    def __init__(self, text: str) -> None:
        """Find branches, routines, calls and settings."""
        self._ever_off = {match[1].upper() for match in SWITCHED.finditer(text) if match[2].upper() == "OFF"}
        starts = [match.start() for match in STARTS.finditer(text)]
        control, calls = _control(text)
        self._way = InForce(sorted({*control, *((at, 0) for at, _ in calls)}, key=lambda one: one[0]), starts)
        self._switched: dict[str, InForce] = {}
        for kind in self._ever_off:
            settings: list[tuple[int, object]] = [
                (match.start(), match[2].upper()) for match in SWITCHED.finditer(text) if match[1].upper() == kind
            ]
            settings += [(at, UNKNOWN) for at in starts]  # a routine begins with what its caller left
            settings += _set_by_calls(text, _in_force(control, starts, settings), calls)
            self._switched[kind] = _in_force(control, starts, settings)

    def has_unbranched_path(self, first: int, second: int) -> bool:
        """Say whether the program always comes from one place to the other."""
        return self._way.has_unbranched_path(first, second)

    def off(self, kind: str, at: int) -> tuple[bool, ...]:
        """Return whether ConfL or ConfJ (``kind``) is off at a place: one answer, or both where the text does not say."""
        if kind not in self._ever_off:
            return (False,)
        known, value = self._switched[kind].value_in_effect(at)
        return (value == "OFF",) if known and value in ("ON", "OFF") else (False, True)


def _in_force(control: Sequence[Place], starts: Sequence[int], settings: Sequence[tuple[int, object]]) -> InForce:
    force = InForce(control, starts)
    for at, value in sorted(settings, key=lambda one: one[0]):
        force.set(at, value)
    return force


def _set_by_calls(text: str, own: InForce, calls: Sequence[tuple[int, str]]) -> list[tuple[int, object]]:
    """What calls set: the value with which a routine ends that calls no other one that sets it, else one not known."""
    names = {own.owner(match.end()): match[1].upper() for match in ROUTINE.finditer(text)}
    ends = {name: (own.starts[number] - 1 if number < len(own.starts) else len(text)) for number, name in names.items()}
    setting = {names.get(own.owner(at), "") for at, value in own.settings if value != UNKNOWN}
    plain = set(setting)
    while more := {names.get(own.owner(at), "") for at, name in calls if name in setting} - setting:
        setting |= more
    plain -= {names.get(own.owner(at), "") for at, name in calls if name in setting}
    found: list[tuple[int, object]] = []
    for at, name in calls:
        if name in setting:
            known, value = own.value_in_effect(ends[name]) if name in plain and name in ends else (False, UNKNOWN)
            found.append((at, value if known else UNKNOWN))
    return found


def _control(text: str) -> tuple[list[Place], list[tuple[int, str]]]:
    """The places at which a program branches, and the calls of routines that may move the arm, with their names."""
    control: list[Place] = [(match.start(), None) for match in LABEL.finditer(text)]
    calls: list[tuple[int, str]] = []
    for match in STATEMENT.finditer(text):
        at, word = match.start(1), match[1].upper()
        if word in WAYS:
            statement = text[at : at + LONGEST].partition(";")[0]
            end = at + len(statement)
            short = word == "IF" and THEN.search(statement) is None  # IF on one line, without ENDIF
            control += [(at, 0), (end, 0)] if short else [(at, WAYS[word])]
            calls += [(at, one.upper()) for one in re.findall(r"[A-Za-z]\w*", statement)] if short else []
        elif STAYS.fullmatch(word) is None and ASSIGNED.match(text, match.end()) is None:
            calls.append((at, word))
    return sorted(control, key=lambda one: one[0]), calls
