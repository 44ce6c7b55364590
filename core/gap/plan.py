"""Poses that tell two named effects apart, without a hunt before: the planning job's purpose "separate A from B"."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from core.errors import OptionError
from core.gap.candidates import Candidate, with_testable
from core.gap.next_poses import rows_of, separate
from core.gap.options import GapOptions
from core.gap.prepare import Workshop
from core.gap.testability import testability
from core.model import Calibration
from core.observations import Observations
from core.robot import Robot

Named = tuple[str, Sequence[int] | None]  # id, joints from 0 (None: as the effect acts by itself)


def plan_separation(
    robot: Robot,
    observations: Observations,
    first: Named,
    second: Named,
    count: int = 12,
    options: GapOptions | None = None,
    start: Calibration | None = None,
) -> list[dict[str, Any]]:
    """Poses, loads and directions that separate two effects best, given what was measured already.

    The first effect is taken at three times what these observations could just see. Rows as ``next_poses`` of a gap
    report, a change of conditions first where that is worth more.

    Raises:
        OptionError: an effect these observations cannot have, with the ones they can.

    """
    options = options or GapOptions()
    prepared = Workshop(start or Calibration.nominal(robot), observations, options, lambda f, s: None).run()
    world = prepared.world
    judged = testability(world, prepared.library)
    candidates = with_testable(prepared.library, world.scale > 0.0)
    target, rival = _found(candidates, first), _found(candidates, second)
    sizes = np.array([p.prior_sigma for p in prepared.library.parameters])
    amplitudes = np.where(np.isfinite(judged.smallest), 3.0 * judged.smallest, sizes)[list(target.columns)]
    rows = prepared.visits.observations
    return rows_of(
        separate(world, rows, target, [rival], (), amplitudes, count, options.seed), (target.label, rival.label), robot
    )


def _found(candidates: Sequence[Candidate], wanted: Named) -> Candidate:
    effect, joints = wanted
    own = [c for c in candidates if c.id == effect]
    exact = [c for c in own if joints is None or c.joints == tuple(joints)]
    if not exact:
        offered = sorted({c.label for c in own} or {c.id for c in candidates})
        raise OptionError(
            f"These observations cannot show {effect} at {'any joint' if joints is None else [j + 1 for j in joints]}. "
            f"They can show: {', '.join(offered)}.",
            effect=effect,
        )
    return max(exact, key=lambda c: len(c.columns)) if joints is None else exact[0]
