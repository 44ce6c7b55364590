"""The columns of a log's model, joint by joint, and what they need to be computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.motion.effects import CARRIED_MASS, FADE_SHARE, MOTION_EFFECTS, JointSignals, MotionEffect, Wanted
from kilter_core.motion.record import Log, Path
from kilter_core.motion.regressor import (
    PER_LINK,
    base_columns,
    joint_behind_link,
    link_elements,
    numbers_of_point,
    rigid_regressor,
    shown_columns,
    tool_in_link,
)
from kilter_core.types import Floats, Ints

DELAY_STEP_S = 0.005  # between delays that are tried
MOST_CARRIED = 60  # columns of masses that are carried in one session; where there are many, only outer links carry


@dataclass(frozen=True, eq=False)
class Term:
    """An effect at a joint (from 0) and its columns of the whole layout; in one ``session``, where it is a mass on a link."""

    effect: MotionEffect
    joint: int
    columns: Ints
    session: int | None = None


@dataclass(frozen=True)
class Bodies:
    """Of a path: columns (N, n, m) that all joints share, and torques ``stated (N, n)`` N m of the payload that it states."""

    columns: Floats
    stated: Floats


@dataclass(frozen=True)
class Layout:
    """``kept (p,)`` columns of the regressor come first, then those of the ``terms``, ``width`` in all.

    Of each joint: the speed that it usually reaches, the middle of its range, the order of its ripple, the delay (s) of its
    torque, and the speed at which its friction of breaking loose has faded. ``mean_t`` s and ``mean_c`` are means of the log.
    ``carried`` are columns of the regressor that count in one session only, as candidates or in every model: theirs follow.
    """

    robot: Robot
    kept: Ints
    terms: tuple[Term, ...]
    width: int
    speeds: Floats
    middles: Floats
    orders: tuple[float | None, ...]
    mean_t: float
    mean_c: float
    carried: tuple[tuple[int, Ints, bool], ...] = ()
    delays: tuple[float, ...] = ()
    fades: tuple[float, ...] = ()

    @classmethod
    def of_log(cls, robot: Robot, log: Log, loaded: int | None = None) -> Layout:
        """Return the layout that every model has: rigid bodies, common effects, a body at the tool in session ``loaded``."""
        kept = base_columns(robot)
        n = robot.n_joints
        speeds, low, high = np.zeros(n), np.full(n, np.inf), np.full(n, -np.inf)
        times, warmth = [], []
        for part in log.parts():
            speeds = np.maximum(speeds, np.quantile(np.abs(part.qd), 0.95, axis=0))
            low, high = np.minimum(low, part.q.min(axis=0)), np.maximum(high, part.q.max(axis=0))
            times += [float(part.t[0]), float(part.t[-1])]
            warmth += [] if part.temperature_c is None else [float(part.temperature_c.mean())]
        mean_c = float(np.mean(warmth)) if warmth else np.nan
        bare = cls(
            robot,
            kept,
            (),
            len(kept),
            np.maximum(speeds, 1e-6),
            0.5 * (low + high),
            (None,) * n,
            float(np.mean(times)),
            mean_c,
            () if loaded is None else ((loaded, _outermost_columns(robot), True),),
        )
        return bare._with_effects([effect for effect in MOTION_EFFECTS if effect.common])

    def with_candidates(
        self,
        orders: Sequence[float | None],
        delays: Sequence[float] = (),
        fades: Sequence[float] = (),
        sessions: Sequence[int] = (),
        wanted: Wanted | None = None,
    ) -> Layout:
        """Return the layout with the library's effects, or those ``wanted``; ripples of these orders, torques about as late as
        the ``delays``, breaking loose that ends about at the ``fades``, and masses carried in ``sessions``.
        """
        sessions = sessions if wanted is None else ()
        most = max(1, MOST_CARRIED // (PER_LINK * max(1, len(sessions))))
        shown = shown_columns(self.robot)[-most:] if sessions else []
        carried = [(session, columns, False) for session in sessions for columns in shown if len(columns)]
        found = replace(
            self,
            orders=tuple(orders),
            delays=tuple(delays),
            fades=tuple(fades),
            carried=(*self.carried, *carried),
        )
        return found._with_effects(MOTION_EFFECTS, wanted)

    def _with_effects(self, effects: Sequence[MotionEffect], wanted: Wanted | None = None) -> Layout:
        terms, at = [], len(self.kept)
        for session, columns, common in self.carried:
            shown = tuple(CARRIED_MASS.parameters[c % PER_LINK] for c in columns.tolist())
            effect = replace(CARRIED_MASS, parameters=shown, common=common)
            joint = joint_behind_link(self.robot, int(columns[0]) // PER_LINK)
            terms.append(Term(effect, joint, np.arange(at, at + len(shown)), session))
            at += len(shown)
        for j in range(self.robot.n_joints):
            for effect in effects:
                joints = wanted.get(effect.id, frozenset()) if wanted is not None and not effect.common else None
                if (
                    (joints is not None and j not in joints)
                    or ("temperature" in effect.needs and np.isnan(self.mean_c))
                    or ("order" in effect.needs and self.orders[j] is None)
                ):
                    continue
                terms.append(Term(effect, j, np.arange(at, at + len(effect.parameters))))
                at += len(effect.parameters)
        return replace(self, terms=tuple(terms), width=at)

    @property
    def fade_speeds(self) -> tuple[float, ...]:
        """Speeds (n,) at which breaking loose has faded: as found, else a share of what each joint usually reaches."""
        return self.fades or tuple((FADE_SHARE * self.speeds).tolist())

    @property
    def n_body_columns(self) -> int:
        """Number of columns that all joints share, masses of one session with them."""
        return len(self.kept) + sum(len(columns) for _, columns, _ in self.carried)

    def bodies(self, part: Path) -> Bodies:
        """Return the columns of a path that all joints share: bodies, and what is carried."""
        Y = rigid_regressor(self.robot, part.q, part.qd, part.qdd)
        centre = tool_in_link(self.robot) @ np.append(part.payload_com, 1.0)
        stated = Y[:, :, _outermost_columns(self.robot)] @ numbers_of_point(part.payload_kg, centre[:3])
        carried = [Y[:, :, one] * float(part.session == session) for session, one, _ in self.carried]
        return Bodies(np.concatenate([Y[:, :, self.kept], *carried], axis=2), stated)

    def joint_columns(self, part: Path, bodies: Bodies, j: int, known: Known | None) -> Floats:
        """Columns (N, m) of one joint: those that all joints share, then its terms in order."""
        signals = self.signals(part, bodies, j, known)
        return np.concatenate(
            [bodies.columns[:, j], *(t.effect.columns(signals) for t in self._terms_of_joint(j))], axis=1
        )

    def places(self, j: int) -> Ints:
        """Where the columns of a joint stand in the whole layout."""
        return np.concatenate([np.arange(self.n_body_columns), *(t.columns for t in self._terms_of_joint(j))])

    def _terms_of_joint(self, j: int) -> list[Term]:
        return [t for t in self.terms if t.joint == j and t.session is None]

    def signals(self, part: Path, bodies: Bodies, j: int, known: Known | None) -> JointSignals:
        """Return what effects at a joint read; without a model so far there is no load."""
        load, none = self._load(part, bodies, j, known), np.zeros(len(part.t))
        warm = none if part.temperature_c is None else part.temperature_c - self.mean_c
        bare = JointSignals(
            part.q[:, j],
            part.qd[:, j],
            part.qdd[:, j],
            load,
            none,
            none,
            part.t - self.mean_t,
            warm,
            float(self.speeds[j]),
            float(self.middles[j]),
            self.orders[j],
            self.delays[j] if self.delays else DELAY_STEP_S,
            self.fade_speeds[j],
        )
        if known is None:
            return bare
        model = load + known.friction(bare, j)
        if known.in_time is None:
            return replace(bare, model=model, in_time=model)
        in_time = self._load(part, bodies, j, known.in_time) + known.in_time.friction(bare, j)
        return replace(bare, model=model, in_time=in_time)

    def _load(self, part: Path, bodies: Bodies, j: int, known: Known | None) -> Floats:
        if known is None:
            return np.zeros(len(part.t))
        return np.asarray(bodies.columns[:, j, : len(known.base)] @ known.base + bodies.stated[:, j])


@dataclass(frozen=True)
class Known:
    """A model so far: values (m,) of the columns that all joints share, and of the effects that every model has by id and
    joint; and the model ``in_time``, where it is another, which was fitted to torques as if none were late.
    """

    base: Floats
    common: Mapping[tuple[str, int], Floats]
    in_time: Known | None = None

    @classmethod
    def from_values(cls, layout: Layout, theta: Floats, in_time: Known | None = None) -> Known:
        """Return what the values (width,) of a layout say."""
        common = {(t.effect.id, t.joint): theta[t.columns] for t in layout.terms if t.effect.common}
        return cls(theta[: layout.n_body_columns], common, in_time)

    def friction(self, signals: JointSignals, j: int) -> Floats:
        """Torque (N,) of the effects that every model has at a joint, N m."""
        return np.asarray(sum(e.columns(signals) @ self.common[e.id, j] for e in MOTION_EFFECTS if e.common))


def _outermost_columns(robot: Robot) -> Ints:
    """Columns (10,) of the regressor that the body at the tool has."""
    return PER_LINK * int(np.argmax(link_elements(robot))) + np.arange(PER_LINK)
