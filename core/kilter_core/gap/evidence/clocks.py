"""Laws that share a clock have one cause among them: that something went with it is one claim, and where is another."""

from __future__ import annotations

from collections.abc import Iterable

from kilter_core.effects.physical import OF_CLOCK, PhysicalClass, Separator
from kilter_core.gap.evidence.separators import Separated
from kilter_core.gap.search.candidates import Candidate

Law = tuple[Candidate, tuple[Separated, ...], float]  # with the evidence for it, and how far it moves the tool


def shared_clock(law: Law, others: Iterable[Law]) -> PhysicalClass | None:
    """Return the class of the clock that a named law shares with another one; None where it has its clock to itself.

    A scale about the station is a drift of the base beside a growth of the arm, exactly: two laws of one clock that are
    named together may be one that the library lacks. A sensor at the place itself tells.
    """
    alike = [other for other in others if _shares(law, other)]
    if not alike:
        return None
    event = law[0].effects[0].event  # it has a time and no course: it goes with the clock of the others
    clocks = [_clocks(c, e) if event else {c.effects[0].clock} for c, e, _ in (alike if event else [law, *alike])]
    return OF_CLOCK["t" if "t" in set().union(*clocks) else "temperature_c"]


def _shares(law: Law, other: Law) -> bool:
    """Whether a law may be a part of what another one is a part of."""
    (own, told, moved), (rival, asked, far) = law, other
    one, two = own.effects[0], rival.effects[0]
    if not one.clock or not two.clock or own.id == rival.id or two.event or _is_sensed(told) or _is_sensed(asked):
        return False
    if one.event:  # what a law of another course leaves may pass for a jump, but for none larger than the law
        return far >= moved
    return bool(_clocks(own, told) & _clocks(rival, asked))


def _clocks(candidate: Candidate, evidence: Iterable[Separated]) -> set[str]:
    """What a law may follow: a temperature that went along with time is time too."""
    clock = candidate.effects[0].clock
    apart = any(e.separator is Separator.TEMPERATURE and e.met for e in evidence)
    return {clock} if apart or clock != "temperature_c" else {clock, "t"}


def _is_sensed(evidence: Iterable[Separated]) -> bool:
    return any(e.separator is Separator.SENSOR and e.met for e in evidence)
