"""Gates and verdicts (E7): what it takes to say an effect's name, and what to say when it is not enough."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.effects.physical import OF_CLOCK, PhysicalClass, Separator
from kilter_core.gap.evidence.claim import CLASS, MEMBER, ONE_OF, Claim
from kilter_core.gap.evidence.control import Control
from kilter_core.gap.evidence.fits.intervals import Amplitude
from kilter_core.gap.evidence.halves import Halves
from kilter_core.gap.evidence.held_out.adequacy import Adequacy
from kilter_core.gap.evidence.held_out.practical_size import Misfit
from kilter_core.gap.evidence.replication import Replication
from kilter_core.gap.evidence.separators import Separated
from kilter_core.gap.evidence.similarity.aliases import SAME, Alias, correlation
from kilter_core.gap.evidence.stability import INCLUDED
from kilter_core.gap.search.candidates import Candidate, Library
from kilter_core.gap.search.forward_selection import SearchResult

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


SURE_GAIN = 3.0  # standard deviations by which held-out poses must err as predicted
SHADOWED = 0.3  # correlation with an unknown curve above which a named effect may be part of it
CONTRADICTED = "contradicted"  # verdict of an effect against which rows speak that no choice saw
CONTRADICTS = 2.0  # standard deviations on the wrong side of zero, or beyond the plausible range


@dataclass(frozen=True)
class Evidence:
    """What the gates look at for one chosen candidate."""

    place: int
    candidate: Candidate
    aliases: tuple[Alias, ...]
    inclusion: tuple[float, float] | None  # of its own name, of its class; None: no time to resample
    held_out: tuple[float, float, float]  # gain, its standard error, and how surely it was predicted
    control: Control | None
    amplitudes: tuple[Amplitude, ...]
    p_value: float
    gain_mm: float
    local_bump: bool = False  # a local bump of its joint does as well
    unseen_poses: int = 0  # held-out poses that took no part in choosing
    seen_joints: tuple[int, ...] | None = None  # of those it acts at, where the data show it; None: acts at none
    seen: bool = True  # whether the data show any of it
    moves_mm: float = float("inf")  # rms displacement of the tool by it, over the poses
    replication: Replication | None = None
    separated: tuple[Separated, ...] = ()  # evidence for the name within its physical class
    halves: Halves | None = None  # where something else is left
    untimed: bool = False  # no time to ask them
    left_mm: float = 0.0  # of the rows that were searched, with all that was named
    borne: tuple[int, ...] | None = None  # joints at which they bear it out; None: not asked, or acts at none

    @property
    def is_contradicted(self) -> bool:
        """Whether rows that no choice saw speak against it: a confirmation, or held-out poses that err more with it.

        A confirmation that bears it out outweighs the few poses that were held out: one lost by a third of its deviation there.
        """
        again = self.replication is not None and self.replication.is_contradicted
        return again or (self.unseen_poses > 0 and self.held_out[0] < 0.0 and not self.is_surely_replicated)

    @property
    def is_told_by_friction(self) -> bool:
        """Whether torques chose its name: resamples of the rows choose its twin as often."""
        return any(e.separator is Separator.FRICTION and e.met for e in self.separated)

    @property
    def law(self) -> Law:
        """What tells whether it shares a clock with another."""
        return self.candidate, self.separated, self.moves_mm

    @property
    def lasts(self) -> bool:
        """Whether it rises on its own evidence where something else is left: between halves, or in a confirmation."""
        return self.is_surely_replicated or (self.halves is not None and self.halves.lasts)

    @property
    def is_surely_replicated(self) -> bool:
        """Whether a confirmation shows it with the same amplitude, and is predicted better by it beyond chance."""
        return self.replication is not None and self.replication.certain


@dataclass(frozen=True)
class Judged:
    """Verdict on one candidate with the gates it passed and the number behind each; ``alias_set``: physical rivals."""

    evidence: Evidence
    verdict: str
    gates: dict[str, bool | None]  # None: not tested, for want of time
    numbers: dict[str, float | None]
    alias_set: tuple[Alias, ...]
    claim: Claim
    measured: str = ""  # of a curve of a joint, the range that it is claimed for, in words

    @property
    def display_name(self) -> str:
        """Name for people: the narrowest set that the data single out, and the range that a curve is claimed for."""
        return self.claim.words + self.measured

    @property
    def of_arm(self) -> bool:
        """Whether the arm itself does it: of what went with a clock base, station and air may, or rivals that are these."""
        elsewhere = (effect for a in self.alias_set for effect in a.candidate.effects)
        return self.claim.has_known_location and not any(
            e.clock and e.stage in ("base", "measurement") for e in elsewhere
        )

    @property
    def certain(self) -> bool:
        """Whether it happened, and not only something of its class."""
        return self.verdict in SURE and not self.claim.is_confounded and self.claim.said != CLASS

    @property
    def storable(self) -> bool:
        """Whether a version is to hold it: nothing that is contradicted, and no step or drift that is not settled.

        What another name does as well moves the arm otherwise on another day. Where nothing was held out all other gates
        settle it: fitted without a station's step of 5 mm, the geometry takes it up. What happened once is in one half of
        a campaign only: there it must outweigh what is left.
        """
        effect = self.evidence.candidate.effects[0]
        of_base = effect.stage == "base" and "temperature_c" in effect.needs
        passing = effect.event or "t" in effect.needs or of_base
        failed = {name for name, passed in self.gates.items() if not passed}
        once = effect.event and self.evidence.gain_mm > self.evidence.left_mm
        settled = failed <= {"unseen_poses", *(("lasts",) if once else ())} and self.claim.said != ONE_OF
        return self.verdict != CONTRADICTED and (settled or not passing)


def judge(
    search: SearchResult,
    evidence: Evidence,
    fit: Adequacy,
    library: Library,
    settled: bool,
    lacking: bool = False,
    beside: Iterable[Evidence] = (),
) -> Judged:
    """Pass one candidate through the gates: replicated, confirmed, class_confirmed, provisional, or contradicted.

    ``settled`` says that nothing is left of which it may be a part; ``lacking`` that rotations which the robot's description
    lacks do as well as all that was named; ``beside`` is the evidence for everything that was.
    """
    rivals = tuple(a for a in evidence.aliases if a.member or not a.candidate.empirical)
    beside = tuple(beside)
    curves = _curves(search, evidence, beside)
    again = evidence.is_surely_replicated
    numbers = _numbers(search, evidence, fit, library, bool(rivals) or again, curves)
    replication = evidence.replication
    gates: dict[str, bool | None] = {
        "physical": not evidence.candidate.empirical,
        "lasts": settled or evidence.lasts or (None if evidence.untimed else False),
        "held_out": again or (evidence.held_out[0] > 0.0 and evidence.held_out[2] > SURE_GAIN),
        "unseen_poses": evidence.unseen_poses > 0 or (replication is not None and replication.is_replicated),
        "no_empirical_alias": len(rivals) == len(evidence.aliases)
        and not evidence.local_bump
        and not _is_shadowed_by_curve(search, evidence, curves),
        "plausible": _plausible(evidence, library),
        "seen": evidence.seen,
        "inclusion": None if numbers["inclusion"] is None else numbers["inclusion"] >= INCLUDED,
        "negative_control": evidence.control is None or evidence.control.has_passed,
    }
    if replication is not None:
        gates["confirmation"] = replication.outcome not in (CONTRADICTED, "other_size")
    if lacking:
        gates["complete_geometry"] = False
    robot = search.problem.settings.source.model.robot
    alone = settled and not _beside_any_shape(search, evidence)
    shared = shared_clock(evidence.law, (one.law for one in beside if one.place != evidence.place))
    claim = Claim.from_evidence(evidence.candidate, robot, rivals, evidence.separated, alone, evidence.borne, shared)
    if _sensor_significance(evidence) is not None:
        gates["sensor"] = not claim.is_refuted_by_sensor
    level = CONTRADICTED if evidence.is_contradicted else _level(gates, claim, replication)
    return Judged(evidence, level, gates, numbers, rivals, claim)


def _beside_any_shape(search: SearchResult, evidence: Evidence) -> bool:
    """Whether another name of its class and joint takes any shape: beside a walk, a step may be what its pieces leave.

    So does a curve without a cause: beside it only the class is claimed.
    """
    robot, candidates = search.problem.settings.source.model.robot, search.selector.scorer.candidates
    own = evidence.candidate.effects[0].physical_class(robot).id
    at = set(evidence.candidate.joints or ())
    others = (candidates[k] for k in search.chosen if k != evidence.place)
    near = (c.effects[0] for c in others if not c.joints or not at or at & set(c.joints))
    return any((e.supple or e.empirical) and e.physical_class(robot).id == own for e in near)


def _level(gates: dict[str, bool | None], claim: Claim, replication: Replication | None) -> str:
    """The highest level that the gates allow: what was seen again is replicated, and no more than its claim says."""
    if not all(gates.values()):
        return "provisional"
    if replication is not None and replication.is_replicated:
        return "replicated"
    return "confirmed" if claim.said == MEMBER else "class_confirmed"


def _numbers(
    search: SearchResult,
    evidence: Evidence,
    fit: Adequacy,
    library: Library,
    class_: bool,
    curves: Sequence[Candidate],
) -> dict[str, float | None]:
    """What each gate was decided by, to be decided again with other thresholds."""
    gain, _, deviations = evidence.held_out
    replication = evidence.replication
    numbers: dict[str, float | None] = {
        "physical": float(not evidence.candidate.empirical),
        "adequate": fit.p_value,
        "lasts": None if evidence.halves is None else float(evidence.lasts),
        "held_out": deviations if gain > 0.0 else min(deviations, 0.0),
        "unseen_poses": float(evidence.unseen_poses),
        "no_empirical_alias": nearest_shape(search, evidence.place),
        "bumped": float(evidence.local_bump),
        "shadowed": _shadow(search, evidence, curves),
        "plausible": max((_beyond(a, library, evidence.candidate) for a in evidence.amplitudes), default=0.0),
        "seen": float(evidence.seen),
        "inclusion": None
        if evidence.inclusion is None
        else evidence.inclusion[1 if class_ or evidence.is_told_by_friction else 0],
        "negative_control": None
        if evidence.control is None or not evidence.control.shuffles
        else evidence.control.survived,
    }
    if (sensor := _sensor_significance(evidence)) is not None:
        numbers["sensor"] = sensor
    return (
        numbers
        if replication is None
        else numbers | {"confirmation": replication.apart, "confirmation_p": replication.p_value}
    )


def _sensor_significance(evidence: Evidence) -> float | None:
    """Standard deviations in which a sensor at the place shows it, None where none could."""
    return next((e.number for e in evidence.separated if e.separator is Separator.SENSOR and e.told), None)


def nearest_shape(search: SearchResult, place: int) -> float | None:
    """Points that the best shape without a cause is behind the chosen one in its place; None without such shapes."""
    selector, gram = search.selector, search.problem.gram
    scores = selector.scorer.scores(
        gram.condition_on_columns(selector.columns([k for k in search.chosen if k != place]))
    )
    value = scores.S / selector.variance(gram, search.chosen) - scores.d * np.log(selector.rows) - selector.scorer.paid
    shapes = selector.scorer.empirical & (scores.d > 0)
    shapes[list(search.chosen)] = False
    return float(value[place] - np.max(value[shapes])) if shapes.any() else None


def run_verdict(judged: tuple[Judged, ...], adequacy: Adequacy, misfit: Misfit) -> str:
    """Verdict of the run: no_gap, closed, unexplained, provisional. What is too small to matter leaves nothing open.

    Without a noise that is known apart from the fit nobody can say that nothing is left: not_known.
    """
    if any(j.evidence.candidate.empirical and misfit.matters(j.evidence.moves_mm) for j in judged):
        return "unexplained"
    if adequacy.adequate is False and not misfit.too_small:
        return "unexplained"
    weighty = [j for j in judged if misfit.matters(j.evidence.moves_mm)]
    if weighty and (adequacy.adequate is None or any(j.verdict not in SURE for j in weighty)):
        return "provisional"
    if adequacy.relative:
        return "not_known"
    return "closed" if judged else "no_gap"


SURE = {
    "replicated": "replicated",
    "confirmed": "confirmed",
    "class_confirmed": "confirmed as a class",
}


def sentence(verdict: str, judged: tuple[Judged, ...], adequacy: Adequacy, misfit: Misfit, left: str) -> str:
    """Say the verdict in words; ``left`` says how much remains, and where."""
    likely = tuple(j for j in judged if j.verdict != CONTRADICTED)
    names = ", ".join(_once(likely))
    sure = ", ".join(_once([j for j in judged if j.verdict in SURE]))
    relative = ""
    if adequacy.adequate is None:
        whose = (
            "The repeats do not tell how large the noise is"
            if adequacy.has_doubtful_noise
            else "The noise is that of the fit itself"
        )
        relative = f" {whose}, so this is relative to it."
    if verdict == "not_known":
        relative = " Approach ten poses three times each, with other poses between."
    noise = "within their noise" if not misfit.too_small else "but for a difference too small to matter"
    said = {
        "no_gap": "Nothing in the library is significant above the noise.",
        "not_known": "Whether something is missing is not known, because no noise is known apart from the fit. "
        "Nothing in the library is significant above what the fit leaves.",
        "closed": f"{sure}: confirmed among the causes of the library. With this the model agrees with the measurements "
        f"{noise}."
        if sure
        else f"Nothing that matters is missing: the model agrees with the measurements {noise}.",
        "provisional": _risen(likely, adequacy, left)
        or (_likely(_once(likely), likely) if likely else "Nothing is named that unseen rows bear out."),
        "unexplained": _risen(likely, adequacy, left)
        or _describe_shapes(likely, adequacy)
        or f"Something is left that no known effect explains{left}."
        + (f" In part it looks like {names}." if names else ""),
    }
    against = _once([j for j in judged if j.verdict == CONTRADICTED])
    little = f" {', '.join(against)}: contradicted, and left out of the version." if against else ""
    small = _once([j for j in judged if not misfit.matters(j.evidence.moves_mm)])
    little += f" Too small to matter: {', '.join(small)}." if small else ""
    if misfit.too_small and verdict == "no_gap":
        little += f" What is left beyond the noise, {misfit.size_text}, is too small to matter."
    return said[verdict] + little + relative


def _describe_shapes(judged: tuple[Judged, ...], adequacy: Adequacy) -> str:
    """Say of shapes without a cause that with them the rows leave nothing; empty where there are none, or something is left."""
    shapes = _once([j for j in judged if j.evidence.candidate.empirical])
    if not shapes or not adequacy.adequate:
        return ""
    rest = [name for name in _once(judged) if name not in shapes]
    likely = f" {_likely(rest, judged)}" if rest else ""
    return (
        f"{', '.join(shapes)}: of no known cause, but with this shape the model agrees with the rows searched.{likely}"
    )


def _likely(names: Sequence[str], judged: Sequence[Judged]) -> str:
    """Say of names that are not sure whether they failed a test, or whether there was no time for all of them."""
    failed = any(passed is False for j in judged if j.display_name in names for passed in j.gates.values())
    return f"{', '.join(names)}: likely, but not every test was {'passed' if failed else 'made'}."


def _once(judged: Sequence[Judged]) -> list[str]:
    """What they are called: two shapes of one error of a joint are one error."""
    return list(dict.fromkeys(j.display_name for j in judged))


def _risen(judged: tuple[Judged, ...], adequacy: Adequacy, left: str) -> str:
    """What is sure although the model as a whole is not, each with its level; empty where nothing is."""
    surely = [j for j in judged if j.verdict in SURE]
    sure = list(dict.fromkeys(f"{j.display_name}: {SURE[j.verdict]}" for j in surely))
    shapes = _once([j for j in judged if j.evidence.candidate.empirical])
    likely = [name for name in _once(judged) if name not in (*_once(surely), *shapes)]
    if not sure:
        return ""
    rest = f" {_likely(likely, judged)}" if likely else ""
    rest = (f" {', '.join(shapes)}: of no known cause." if shapes else "") + rest
    other = {False: f"; something else remains{left}.", None: "; whether something else remains is not known."}
    return "; ".join(sure) + other.get(adequacy.adequate, ".") + rest


def _beyond(a: Amplitude, library: Library, candidate: Candidate) -> float:
    """Standard deviations that an amplitude lies beyond what is plausible, below 0 within it."""
    p, sigma = library.parameters[a.column], max(a.sigma, 1e-300)
    return float(max(p.lower - a.wanted, a.wanted - p.upper) / sigma)


def _plausible(evidence: Evidence, library: Library) -> bool:
    for a in evidence.amplitudes:
        p = library.parameters[a.column]
        if a.wanted < p.lower - CONTRADICTS * a.sigma or a.wanted > p.upper + CONTRADICTS * a.sigma:
            return False
        if evidence.candidate.positive and len(evidence.amplitudes) == 1 and a.wanted <= 0.0:
            return False
    return True


def _shadow(search: SearchResult, evidence: Evidence, curves: Sequence[Candidate]) -> float:
    """Largest correlation with an unknown curve that was needed too."""
    return max(
        (correlation(search.problem.A, evidence.candidate.columns, c.columns) for c in curves),
        default=0.0,
    )


def _is_shadowed_by_curve(search: SearchResult, evidence: Evidence, curves: Sequence[Candidate]) -> bool:
    """Whether an unknown curve of another class was needed too, and could take this effect's place in part."""
    robot, candidate = search.problem.settings.source.model.robot, evidence.candidate
    own = candidate.effects[0].physical_class(robot).id
    others = (c for c in curves if c.effects[0].physical_class(robot).id != own or c.joints != candidate.joints)
    return any(_is_related_to_curve(search, candidate, c) for c in others)


def _curves(search: SearchResult, evidence: Evidence, beside: Sequence[Evidence]) -> list[Candidate]:
    """Shapes without a cause that were named too; one that unseen rows contradict may be a part of no other effect."""
    candidates, refuted = search.selector.scorer.candidates, {one.place for one in beside if one.is_contradicted}
    places = [k for k in search.chosen if k != evidence.place and k not in refuted]
    return [candidates[k] for k in places if candidates[k].empirical]


def _is_related_to_curve(search: SearchResult, candidate: Candidate, curve: Candidate) -> bool:
    """Same joint and a curve of the angle alone, or signatures that overlap after geometry."""
    same_joint = bool(set(candidate.joints or ()) & set(curve.joints or ()))
    of_angle = not candidate.effects[0].needs
    if same_joint and of_angle:
        return True
    rho = correlation(search.problem.A, candidate.columns, curve.columns)
    return bool(rho > SHADOWED and rho < SAME) or bool(np.isclose(rho, 1.0))
