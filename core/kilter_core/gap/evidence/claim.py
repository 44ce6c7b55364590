"""What is claimed of a named effect: the narrowest set that the data single out, said alike on every surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from kilter_core.arm.robot import Robot
from kilter_core.effects import EFFECTS, Effect
from kilter_core.effects.physical import STATION, PhysicalClass, Separator, joint_numbers
from kilter_core.gap.evidence.separators import Separated
from kilter_core.gap.evidence.similarity.similarity import Alias
from kilter_core.gap.search.candidates import Candidate

MEMBER, ONE_OF, CLASS = "member", "one_of", "class"
SHOWN = 3  # names in a sentence
UNNAMED = 20  # names that do as well, from which none of them says anything
FOLLOWED = (
    Separator.TEMPERATURE,
    Separator.ORDER,
)  # of what an effect follows: without it something else may have gone along
REMEDY = "to tell, revisit poses at other times, or measure all in random order"


@dataclass(frozen=True)
class Claim:
    """``said`` of a member by its name, of one of several, or of the physical class; ``words`` are for people.

    ``label`` is the class with its joint, ``members`` are those of the library, ``evidence`` is what separates a member
    from it, ``settled`` whether nothing is left of which the effect may be a part. ``joints`` are those that it is said of.
    """

    said: str
    words: str
    physical: PhysicalClass
    label: str
    members: tuple[str, ...]
    evidence: tuple[Separated, ...]
    settled: bool
    joints: tuple[int, ...] | None = None

    @property
    def is_confounded(self) -> bool:
        """Whether what it follows may have gone along with something else, which then is what acts."""
        return _is_confounded(self.evidence)

    @property
    def has_known_location(self) -> bool:
        """Whether it is known where it acts, and not only that something went with a clock."""
        return not self.physical.clock or self.said != CLASS

    @property
    def is_refuted_by_sensor(self) -> bool:
        """Whether a sensor at the place speaks against it; where revisits bear out a motion, the instrument may have moved."""
        moved = self.physical.id == STATION.id and not self.is_confounded
        return any(e.against for e in self.evidence) and not moved

    @staticmethod
    def from_evidence(
        candidate: Candidate,
        robot: Robot,
        rivals: Sequence[Alias],
        evidence: tuple[Separated, ...],
        settled: bool,
        borne: tuple[int, ...] | None = None,
        shared: PhysicalClass | None = None,
    ) -> Claim:
        """Find the narrowest set.

        ``borne`` are the joints at which its own evidence bears it out, where that is asked for; None: all of it.
        ``shared`` is the class of a clock that another law follows too: no more than that is claimed of either.

        Members are named only where every piece of evidence is there, where nothing else is left that may be part of it
        (``settled``), and where no other member of its class does as well.
        """
        joints = candidate.joints if borne is None else borne
        physical = shared or _physical_class_at_joints(candidate, robot, joints)
        evidence, label = _required_evidence(evidence), physical.label_for_joints(joints)
        rest = [j for j in candidate.joints or () if j not in (joints or ())]
        if rest:
            label += f", likely of {joint_numbers(rest)} too"
        if shared is None and _is_confounded(evidence):
            label += physical.went
        doubts = [_doubt(e) for e in evidence if e.against or (e.separator is Separator.ORDER and not e.met)]
        kin = (e.id for e in EFFECTS.values() if not e.empirical and _is_kin(e, physical))
        about = (physical, label, tuple(dict.fromkeys((candidate.id, *kin))), evidence, settled, joints)
        names = list(dict.fromkeys((candidate.label, *(a.candidate.label for a in rivals))))
        member = next((a.member for a in rivals if a.member), "")
        smooth = {j for a in rivals if a.member and a.candidate.empirical for j in a.candidate.joints or ()}
        if smooth and smooth != set(joints or ()):  # its name has other joints than are claimed
            member = label + (f", in the shape of {candidate.id.replace('_', ' ')}" if physical.shaped else "")
        if candidate.empirical:
            return Claim(MEMBER, candidate.label, *about)
        if len(names) > UNNAMED:
            return Claim(
                CLASS, f"an effect that these data cannot name ({_format_name_alternatives(names)} do as well)", *about
            )
        if doubts:
            return Claim(CLASS, f"{member or label} ({'; '.join(doubts)})", *about)
        if member:
            return Claim(CLASS, member, *about)
        if shared is not None:
            return Claim(CLASS, label, *about)
        if (
            not settled
            or not all(e.met for e in evidence)
            or (physical.outside and _kin_alone(candidate, robot, rivals))
        ):
            shapes = [candidate.id.replace("_", " "), *names[1:]]
            shape = f", in the shape of {_format_name_alternatives(shapes)}" if physical.shaped else ""
            return Claim(CLASS, label + shape, *about)
        if len(names) > 1:
            return Claim(ONE_OF, _format_name_alternatives(names) + " (these data cannot tell)", *about)
        return Claim(MEMBER, candidate.label, *about)

    def to_document(self) -> dict[str, Any]:
        """The claim, its class with all members, and the evidence asked for."""
        return {
            "claim": {
                "said": self.said,
                "words": self.words,
                "settled": self.settled,
                "joints": None if self.joints is None else [j + 1 for j in self.joints],
                "evidence": [
                    {
                        "name": e.separator.name.lower(),
                        "words": e.separator.value,
                        "met": e.met,
                        "number": e.number,
                        "told": e.told or None,
                    }
                    for e in self.evidence
                ],
            },
            "physical_class": {
                "id": self.physical.id,
                "label": self.label,
                "members": list(self.members),
                "outside": list(self.physical.outside),
            },
        }


def _physical_class_at_joints(candidate: Candidate, robot: Robot, joints: Sequence[int] | None) -> PhysicalClass:
    """Class of a candidate at some of its joints: of prismatic and revolute ones together, that which says the least."""
    own = [e for e in candidate.effects if joints is None or not e.joints or set(e.joints) & set(joints)]
    classes = list(dict.fromkeys(e.physical_class(robot) for e in own or candidate.effects))
    return next((c for c in classes if not c.shaped), classes[0])


def _is_kin(effect: type[Effect], physical: PhysicalClass) -> bool:
    """Whether an effect of the library is of a class: of that of a clock every law that follows it."""
    return effect.physical.id == physical.id or bool(physical.clock and effect.clock == physical.clock)


def _kin_alone(candidate: Candidate, robot: Robot, rivals: Sequence[Alias]) -> bool:
    """Whether what does as well are others of its class at its place: what these data cannot tell from another member,
    they cannot tell from those of no library.
    """
    others = [a.candidate for a in rivals]
    own = candidate.effects[0].physical_class(robot).id
    return bool(others) and all(
        o.joints == candidate.joints and o.effects[0].physical_class(robot).id == own for o in others
    )


def _doubt(evidence: Separated) -> str:
    return f"{evidence.told}; {REMEDY}" if evidence.separator is Separator.ORDER else evidence.told


def _is_confounded(evidence: Sequence[Separated]) -> bool:
    return any(e.separator in FOLLOWED and not e.met for e in evidence)


def _required_evidence(evidence: tuple[Separated, ...]) -> tuple[Separated, ...]:
    """The evidence asked for: where a sensor saw the effect itself, the order of the poses no longer matters."""
    sensed = any(e.separator is Separator.SENSOR and e.met for e in evidence)
    return tuple(e for e in evidence if not (sensed and e.separator is Separator.ORDER))


def _format_name_alternatives(names: Sequence[str]) -> str:
    """Names for people: the nearest few, and how many there are besides; all of them stand in the alias set."""
    shown = list(names[:SHOWN]) if len(names) > SHOWN + 1 else list(names)
    rest = [f"{len(names) - len(shown)} others"] if len(shown) < len(names) else []
    return " or ".join([*shown, *rest])
