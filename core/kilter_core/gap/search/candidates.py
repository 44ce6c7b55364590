"""The library as candidates: an effect at one joint, at all joints together, or as a whole; what cannot be asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from kilter_core.arm.robot import Robot
from kilter_core.effects import EFFECTS, Effect
from kilter_core.errors import OptionError
from kilter_core.observations import CONDITIONS, Observations
from kilter_core.observations.groups import is_trajectory
from kilter_core.parameters import Parameter
from kilter_core.types import Bools

JOINT, FAMILY, WHOLE = "joint", "family", "whole"
OF_THE_ROBOT = "something in the description of the robot or of the rows"

Asked = str | Mapping[str, Any]


@dataclass(frozen=True)
class Candidate:
    """A nameable piece of the library: an effect at some joints (None for effects that do not act at joints).

    ``columns`` are its parameters in the library's order; ``positive`` says physics fixes their sign.
    """

    id: str
    joints: tuple[int, ...] | None
    columns: tuple[int, ...]
    level: str
    empirical: bool = False
    positive: bool = False
    stage: str = "joint"
    effects: tuple[Effect, ...] = ()
    part: bool = False  # a family cut down to joints that show it
    places: int = 1  # in time at which it was tried: the best of so many

    @property
    def bears(self) -> bool:
        """Whether it follows the loads on the joints, and with it the errors of what is known of them."""
        return any(effect.reads for effect in self.effects)

    @property
    def changes_loads(self) -> bool:
        """Whether it is itself an error of the loads."""
        return any(effect.changes_loads for effect in self.effects)

    @property
    def label(self) -> str:
        """Name for people: ``backlash j2``."""
        if self.joints is None:
            return self.id
        if self.level == FAMILY and not self.part:
            return f"{self.id} all"
        return f"{self.id} j{','.join(str(j + 1) for j in self.joints)}"

    def id_and_joints(self) -> dict[str, object]:
        """Id and joints from 1."""
        return {"id": self.id, "joints": None if self.joints is None else [j + 1 for j in self.joints]}


@dataclass(frozen=True)
class Untestable:
    """What these data cannot say, why, and what to measure; ``missing`` is what it lacks, in words that others share."""

    id: str
    joints: tuple[int, ...] | None
    reason: str
    remedy: str
    missing: str = ""


@dataclass(frozen=True)
class Library:
    """Effects completed for this robot and these rows, their parameters in order, and the candidates made of them."""

    effects: tuple[Effect, ...]
    parameters: tuple[Parameter, ...]
    candidates: tuple[Candidate, ...]
    refused: tuple[Untestable, ...]


def build_library(robot: Robot, rows: Observations, started: Sequence[str] = (), only: Sequence[Asked] = ()) -> Library:
    """Every effect that the rows have columns for and the robot can show.

    ``started`` are parameters that the starting model already has; ``only`` restricts the library to some effects,
    or to some joints of them.

    Raises:
        OptionError: ``only`` names an effect or a joint that does not exist, or one that is not searched for.

    """
    at = joints_by_effect(only)
    for effect_id, joints in at.items():
        for j in sorted(joints or ()):
            if j >= robot.n_joints:
                raise OptionError(
                    f"{effect_id} is to be looked for at joint {j + 1}, the robot has {robot.n_joints}.",
                    option="effects",
                )
    shelf = _Shelf(robot, rows, frozenset(started), at)
    for effect_id, kind in EFFECTS.items():
        if effect_id in at or (not at and not kind.learned and not kind.nuisance):
            shelf.add(kind)
    return Library(tuple(shelf.effects), tuple(shelf.parameters), tuple(shelf.candidates), tuple(shelf.refused))


@dataclass
class _Shelf:
    """A library being filled."""

    robot: Robot
    rows: Observations
    started: frozenset[str]
    at: Mapping[str, frozenset[int] | None] = field(default_factory=dict)
    effects: list[Effect] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)
    candidates: list[Candidate] = field(default_factory=list)
    refused: list[Untestable] = field(default_factory=list)

    def add(self, kind: type[Effect]) -> None:
        """Add an effect in all its variants, or say why not."""
        missing = kind.needs - frozenset({"moments"} | set(self.rows._present()))
        if missing:
            columns = " and no ".join(sorted(missing))
            lacking = f"columns: {', '.join(CONDITIONS.get(name, name) for name in sorted(missing))}"
            self.refused.append(Untestable(kind.id, None, f"The observations have no {columns}.", kind.remedy, lacking))
            return
        if kind.event and is_trajectory(self.rows):
            return  # within a motion nothing is at rest between two rows
        at_joint: dict[int, list[Effect]] = {}
        for config in kind.candidate_configurations(self.robot, self.rows):
            try:
                whole = kind(**config).configure_for_robot(self.robot, self.rows)
                whole.parameters(self.robot)
            except OptionError as error:
                self.refused.append(Untestable(kind.id, None, error.message, kind.remedy, OF_THE_ROBOT))
                continue
            for j, effect in self._add_variant(kind, whole, config).items():
                at_joint.setdefault(j, []).append(effect)
        for j, tried in sorted(at_joint.items()):
            self.candidates += [self._candidate(parts, (j,), JOINT) for parts in kind.together(tried)]

    def _add_variant(self, kind: type[Effect], whole: Effect, config: Mapping[str, Any]) -> dict[int, Effect]:
        """Add an effect in one configuration; what it is at each joint by itself."""
        if not kind.at_joints:
            if not self.started & {p.name for p in whole.parameters(self.robot)}:
                self._put(whole)
                self.candidates.append(self._candidate((whole,), None, WHOLE))
            return {}
        single, named = {}, self.at.get(kind.id)
        for j in whole.acting(self.robot.n_joints):
            if named is not None and j not in named:
                continue
            try:
                one = kind(**{**config, "joints": (j,)}).configure_for_robot(self.robot, self.rows)
            except OptionError:
                continue
            if not self.started & {p.name for p in one.parameters(self.robot)}:
                single[j] = one
        if not single:
            return {}
        cut = len(single) < len(whole.acting(self.robot.n_joints))
        if kind.event:  # every joint has a time of its own
            for effect in single.values():
                self._put(effect)
        else:
            self._put(
                kind(**{**config, "joints": tuple(single)}).configure_for_robot(self.robot, self.rows) if cut else whole
            )
        if not kind.alone:
            return single
        for j, effect in single.items():
            self.candidates.append(self._candidate((effect,), (j,), JOINT))
        if len(single) > 1 and not kind.empirical and not kind.event:
            self.candidates.append(self._candidate(tuple(single.values()), tuple(single), FAMILY))
        return single

    def _put(self, effect: Effect) -> None:
        self.effects.append(effect)
        self.parameters += effect.parameters(self.robot)

    def _candidate(self, effects: tuple[Effect, ...], joints: tuple[int, ...] | None, level: str) -> Candidate:
        place = {p.name: k for k, p in enumerate(self.parameters)}
        columns = tuple(place[p.name] for e in effects for p in e.parameters(self.robot))
        first = effects[0]
        return Candidate(
            first.id, joints, columns, level, first.empirical, first.signs == "positive", first.stage, effects
        )


def with_testable(library: Library, testable: Bools) -> tuple[Candidate, ...]:
    """Candidates that the data can see: families cut down to such joints, and left out below two of them."""
    seen = {k: _restrict_to_testable(c, testable) for k, c in enumerate(library.candidates) if c.level != FAMILY}
    out = []
    for k, c in enumerate(library.candidates):
        if c.level != FAMILY:
            if (one := seen[k]) is not None:
                out.append(one)
            continue
        joined = ((m, seen[n]) for n, m in enumerate(library.candidates) if m.id == c.id and m.level == JOINT)
        kept = [m for m, one in joined if one is m and set(m.columns) <= set(c.columns)]
        if len(kept) > 1:
            joints = tuple(j for m in kept for j in m.joints or ())
            columns = tuple(k for m in kept for k in m.columns)
            out.append(replace(c, columns=columns, joints=joints, effects=tuple(e for m in kept for e in m.effects)))
    return tuple(out)


def _restrict_to_testable(candidate: Candidate, testable: Bools) -> Candidate | None:
    """One that is not a family with what of it the data can see; None where they cannot see enough of it for its name."""
    columns = tuple(k for k in candidate.columns if testable[k])
    in_part = candidate.level == WHOLE or all(e.in_part for e in candidate.effects)
    if columns == candidate.columns:
        return candidate
    return replace(candidate, columns=columns) if columns and in_part else None


def joints_by_effect(only: Sequence[Asked]) -> dict[str, frozenset[int] | None]:
    """Ids with the joints (from 0) to look at, None for all; of an effect named twice the joints of both.

    Raises:
        OptionError: an effect that does not exist or is not searched for, or an option that a search chooses itself.

    """
    out: dict[str, frozenset[int] | None] = {}
    for one in only:
        effect_id, joints = _read({"id": one} if isinstance(one, str) else one)
        before = out.get(effect_id, frozenset())
        out[effect_id] = None if joints is None or before is None else before | joints
    return out


def _read(one: Mapping[str, Any]) -> tuple[str, frozenset[int] | None]:
    effect_id = str(one.get("id"))
    kind = EFFECTS.get(effect_id)
    if kind is None:
        raise OptionError(f"There is no effect {effect_id!r}. There are: {', '.join(EFFECTS)}.", option="effects")
    if kind.nuisance:
        raise OptionError(f"{effect_id} is carried by every search, not searched: leave it out.", option="effects")
    if kind.learned:
        raise OptionError(f"{effect_id} is learned, not searched: give it to an identification.", option="effects")
    more = sorted(name for name, value in one.items() if name not in ("id", "joints"))
    if more:
        raise OptionError(
            f"A search chooses {more[0]} of {effect_id} itself: name the effect and its joints alone.", option="effects"
        )
    joints = one.get("joints")
    if joints is None:
        return effect_id, None
    if not kind.at_joints:
        raise OptionError(f"{effect_id} does not act at joints: leave joints out.", option="effects")
    if not joints or not all(type(j) is int and j >= 1 for j in joints):
        raise OptionError(f"joints of {effect_id} is {joints!r}: give joint numbers from 1, as [2].", option="effects")
    return effect_id, frozenset(j - 1 for j in joints)
