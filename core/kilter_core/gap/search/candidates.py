"""The library as candidates: an effect at one joint, at all joints together, or as a whole; what cannot be asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects import EFFECTS, Effect
from kilter_core.effects.joint_coupling import JointCoupling
from kilter_core.effects.random_walk import FEW_PIECES, PIECES, RandomWalk
from kilter_core.effects.settling import Settling, time_constants
from kilter_core.effects.unknown_joint_curve import UnknownJointCurve
from kilter_core.effects.unknown_smooth_curve import UnknownSmoothCurve
from kilter_core.errors import OptionError
from kilter_core.gap.search.requested import Asked, wanted
from kilter_core.observations import CONDITIONS, Observations
from kilter_core.observations.motions import is_trajectory
from kilter_core.parameters import Parameter
from kilter_core.types import Bools

JOINT, FAMILY, WHOLE = "joint", "family", "whole"
OF_THE_ROBOT = "something in the description of the robot or of the rows"


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

    def named(self) -> dict[str, object]:
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


def library_of(robot: Robot, rows: Observations, started: Sequence[str] = (), only: Sequence[Asked] = ()) -> Library:
    """Every effect that the rows have columns for and the robot can show.

    ``started`` are parameters that the starting model already has; ``only`` restricts the library to some effects,
    or to some joints of them.

    Raises:
        OptionError: ``only`` names an effect or a joint that does not exist, or one that is not searched for.

    """
    at = wanted(only)
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
        for config in _variants(kind, self.robot, self.rows):
            try:
                whole = kind(**config).on(self.robot, self.rows)
                whole.parameters(self.robot)
            except OptionError as error:
                self.refused.append(Untestable(kind.id, None, error.message, kind.remedy, OF_THE_ROBOT))
                continue
            self._add_variant(kind, whole, config)
        self._add_whole_curves(kind)

    def _add_variant(self, kind: type[Effect], whole: Effect, config: Mapping[str, Any]) -> None:
        if not kind.at_joints:
            if not self.started & {p.name for p in whole.parameters(self.robot)}:
                self._put(whole)
                self.candidates.append(self._candidate((whole,), None, WHOLE))
            return
        single, named = {}, self.at.get(kind.id)
        for j in whole.acting(self.robot.n_joints):
            if named is not None and j not in named:
                continue
            try:
                one = kind(**{**config, "joints": (j,)}).on(self.robot, self.rows)
            except OptionError:
                continue
            if not self.started & {p.name for p in one.parameters(self.robot)}:
                single[j] = one
        if not single:
            return
        cut = len(single) < len(whole.acting(self.robot.n_joints))
        if kind.event:  # every joint has a time of its own
            for effect in single.values():
                self._put(effect)
        else:
            self._put(kind(**{**config, "joints": tuple(single)}).on(self.robot, self.rows) if cut else whole)
        if kind is UnknownSmoothCurve:
            return  # one order alone is not a smooth curve: the first is a scale error
        for j, effect in single.items():
            self.candidates.append(self._candidate((effect,), (j,), JOINT))
        if len(single) > 1 and not kind.empirical and not kind.event and "drivers" not in config:
            self.candidates.append(self._candidate(tuple(single.values()), tuple(single), FAMILY))

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

    def _add_whole_curves(self, kind: type[Effect]) -> None:
        """The unknown curve of a joint in all its orders at once, beside order by order."""
        if kind is UnknownSmoothCurve:
            self._add_smooth_curves()
        if kind is not UnknownJointCurve:
            return
        own = [c for c in self.candidates if c.id == kind.id and c.effects[0].orders]  # type: ignore[attr-defined]
        for j in sorted({c.joints for c in own if c.joints}):
            parts = tuple(e for c in own if c.joints == j for e in c.effects)
            if len(parts) > 1:
                self.candidates.append(self._candidate(parts, j, JOINT))

    def _add_smooth_curves(self) -> None:
        """Smooth curves of a joint from orders 1 and 2 up to all."""
        orders = [e for e in self.effects if isinstance(e, UnknownSmoothCurve)]
        for j in sorted({j for e in orders for j in e.joints or ()}):
            parts = [_at_joint(e, j) for e in orders if j in (e.joints or ())]
            for most in range(2, len(parts) + 1):
                self.candidates.append(self._candidate(tuple(parts[:most]), (j,), JOINT))


def _at_joint(effect: UnknownSmoothCurve, joint: int) -> UnknownSmoothCurve:
    """The curve of one of its joints alone, on the same range."""
    k = (effect.joints or ()).index(joint)
    centres, halves = effect.centres or (), effect.halves or ()
    return replace(effect, joints=(joint,), centres=(centres[k],), halves=(halves[k],))


def _variants(kind: type[Effect], robot: Robot, rows: Observations) -> list[dict[str, Any]]:
    """Configurations: the default, drivers two joints before, unknown curves order by order and in pairs, settling at
    several paces, walks of few and of many pieces.
    """
    if kind is UnknownSmoothCurve:
        return [{"orders": (m,)} for m in UnknownSmoothCurve().orders]
    if kind is Settling and rows.t is not None and len(rows):
        return [{"tau_s": tau} for tau in time_constants(float(np.ptp(rows.t)))]
    if kind is RandomWalk:
        return [{"pieces": n} for n in (*FEW_PIECES, PIECES)]
    if kind is UnknownJointCurve:
        alone = [{"orders": (m,)} for m in UnknownJointCurve().orders]
        return alone + [{"orders": (), "partner": p} for p in range(robot.n_joints)]
    if kind is JointCoupling:
        return [{}] + [{"joints": (j,), "drivers": (j - 2,)} for j in range(2, robot.n_joints)]
    return [{}]


def with_testable(library: Library, testable: Bools) -> tuple[Candidate, ...]:
    """Candidates that the data can see: families cut down to such joints, and left out below two of them."""
    out = []
    for c in library.candidates:
        if c.level != FAMILY:
            columns = tuple(k for k in c.columns if testable[k])
            if columns and (c.level == WHOLE or len(columns) == len(c.columns)):
                out.append(replace(c, columns=columns))
            continue
        singles = [
            m for m in library.candidates if m.id == c.id and m.level == JOINT and set(m.columns) <= set(c.columns)
        ]
        kept = [m for m in singles if all(testable[k] for k in m.columns)]
        if len(kept) > 1:
            joints = tuple(j for m in kept for j in m.joints or ())
            columns = tuple(k for m in kept for k in m.columns)
            out.append(replace(c, columns=columns, joints=joints, effects=tuple(e for m in kept for e in m.effects)))
    return tuple(out)
