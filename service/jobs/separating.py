"""Poses that tell two effects apart, given what was measured, or poses drawn at random where nothing was."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from core.errors import OptionError
from service.jobs.poses import Pose

if TYPE_CHECKING:
    from core.gap.candidates import Candidate, Library
    from core.gap.next_poses import Proposal
    from core.gap.prepare import Prepared
    from core.model import Calibration
    from core.observations import Observations
    from core.robot import Robot

Named = tuple[str, tuple[int, ...] | None]

IMAGINED_POSES = 60
IMAGINED_NOISE_MM = 0.05


@dataclass(frozen=True)
class Separation:
    """The question: for which robot, after which measurements, how many poses."""

    robot: Robot
    start: Calibration | None
    campaigns: Sequence[Observations]
    noise_mm: float | None
    count: int
    seed: int
    tell: Callable[[float], None]

    def poses(self, first: Named, second: Named) -> tuple[list[Pose], dict[str, Any]]:
        """Poses, those of the better proposal first, and how much they tell.

        Raises:
            OptionError: an effect these observations cannot show, or joints it does not act at.

        """
        from core.gap.aliases import correlation
        from core.gap.next_poses import separate
        from core.gap.world import fitted

        prepared = self._prepared((first[0], second[0]))
        target, rival = (_candidate(prepared.library, named) for named in (first, second))
        world = prepared.world
        values, _ = fitted(world, target.columns)
        sigma = world.setting.source.library_sigma[list(target.columns)]
        amounts = np.where(np.abs(values) > 0.0, values, sigma) if self.campaigns else sigma
        proposals = separate(world, prepared.visits.observations, target, [rival], [], amounts, self.count, self.seed)
        if not proposals:
            raise OptionError(
                "Poses can be planned for measurements of the tool only: name campaigns with positions.",
                option="campaigns",
            )
        about = {
            "separates": [target.label, rival.label],
            "correlation": round(float(correlation(world.A, target.columns, rival.columns)), 4),
            "proposals": [_about(p) for p in proposals],
        }
        return [pose for p in proposals for pose in _poses(p)], about

    def _prepared(self, ids: tuple[str, ...]) -> Prepared:
        from core.gap import GapOptions
        from core.gap.prepare import Workshop
        from core.model import Calibration
        from core.observations import Observations
        from service.campaigns.store import numbered

        begin = self.start or Calibration.nominal(self.robot)
        noise = self.noise_mm
        if self.campaigns:
            rows = Observations.concatenate(numbered(self.campaigns))
        else:
            rows, noise = self._imagined(begin), noise or IMAGINED_NOISE_MM
        options = GapOptions(effects=tuple(dict.fromkeys(ids)), noise_mm=noise, seed=self.seed)
        return Workshop(begin, rows, options, lambda fraction, stage: self.tell(0.5 * fraction)).run()

    def _imagined(self, begin: Calibration) -> Observations:
        """Random poses as a first campaign would measure them: both directions, no load."""
        from core.design.d_optimal import random_poses
        from core.observations import Observations

        rng = np.random.default_rng(self.seed)
        q = random_poses(self.robot, IMAGINED_POSES, rng)
        rows = Observations(
            q, direction=rng.choice([-1.0, 1.0], q.shape), payload_kg=np.zeros(len(q)),
            temperature_c=np.full(len(q), 20.0), t=np.linspace(0.0, 3600.0, len(q)),
        )  # fmt: skip
        noise = (self.noise_mm or IMAGINED_NOISE_MM) * 1e-3
        return replace(rows, position=begin.predict(rows).position + noise * rng.standard_normal((len(q), 3)))


def _candidate(library: Library, named: Named) -> Candidate:
    effect, joints = named
    own = [c for c in library.candidates if c.id == effect]
    fitting = [c for c in own if joints is None or c.joints == joints]
    if not own:
        why = next((f"{u.reason} Remedy: {u.remedy}." for u in library.refused if u.id == effect), "")
        raise OptionError(f"These observations cannot show {effect}. {why}".strip(), option="effects")
    if not fitting:
        raise OptionError(f"{effect} does not act at joints {[j + 1 for j in joints or ()]} alone.", option="effects")
    return max(fitting, key=lambda c: len(c.columns))


def _about(p: Proposal) -> dict[str, Any]:
    return {
        "kind": p.kind, "change": p.change or None, "poses": len(p.rows),
        "information_factor": round(float(p.after[-1] / max(p.before, 1e-12)), 3),
    }  # fmt: skip


def _poses(p: Proposal) -> list[Pose]:
    rows = p.rows
    return [
        Pose(
            q=rows.q[k],
            kind=p.kind,
            change=p.change or None,
            payload_kg=None if rows.payload_kg is None else float(rows.payload_kg[k]),
            direction=None if rows.direction is None else tuple(int(s) for s in rows.direction[k]),
            information_factor=round(float(p.after[k] / max(p.before, 1e-12)), 3),
        )
        for k in range(len(rows))
    ]
