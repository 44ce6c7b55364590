"""What a search could test in some rows, before it is made: the geometry is fitted, nothing is searched."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.gap.evidence.held_out.holding_out import split_held_out_rows
from kilter_core.gap.evidence.replication import refuse_unfit
from kilter_core.gap.evidence.similarity.testability import Testability, Visible, testability, untestable, visible
from kilter_core.gap.expected import probe, run_and_time
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import Library, Untestable
from kilter_core.gap.search.prepare import Prepared, prepare_data
from kilter_core.gap.search.start_model import beginning
from kilter_core.identify.comparison.compare import count_poses, thin_poses
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.motions import is_trajectory
from kilter_core.types import unheard

MOST_POSES = 500  # looked at: half a second


@dataclass(frozen=True)
class GapCheck:
    """What can be tested at the geometry-only fit, and what not; a search that names effects may see more by the end.

    ``poses`` were looked at ``of`` those to search: what fewer poses show is scaled to what all of them would show.
    ``seconds`` is how long the search would take on this machine, without a budget.
    """

    testable: tuple[Visible, ...]
    not_testable: tuple[Untestable, ...]
    poses: int
    of: int
    seconds: float


def check_gap(
    robot: Robot,
    observations: Observations,
    options: GapOptions | None = None,
    start: Calibration | None = None,
    validation: Observations | float | None = None,
    confirmation: Observations | None = None,
) -> GapCheck:
    """Say which effects a search with these options could test in the rows it would search.

    Raises:
        TooFewPosesError, ObservationError, OptionError: what the search would be refused with.

    """
    options = options or GapOptions()
    begin = beginning(robot, start, observations, options)
    if confirmation is not None:
        for rows in (observations, validation):
            if isinstance(rows, Observations):
                refuse_unfit(robot, rows, confirmation)
        refuse_mixed_up(begin, confirmation)
    searched, held = split_held_out_rows(observations, validation, options.seed)
    rows = _fewer(searched)

    def begun() -> Prepared:
        refuse_mixed_up(begin, observations)
        return prepare_data(begin, rows, options, unheard)

    prepared, took = run_and_time(begun)
    unseen = held is not None or confirmation is not None
    seen = testability(prepared.problem, prepared.library)
    judged = _extrapolate_to_all_rows(seen, prepared.library, len(rows) / len(searched))
    return GapCheck(
        tuple(visible(prepared.library, judged)),
        untestable(prepared.library, judged, prepared.problem, prepared.visits.observations),
        count_poses(rows),
        count_poses(searched),
        probe(prepared, seen, options, took, unseen).search(len(searched) / len(rows)),
    )


def _fewer(rows: Observations) -> Observations:
    """At most ``MOST_POSES`` poses, evenly chosen, with their repeats; motions stay, a search averages them by itself."""
    return rows if is_trajectory(rows) or count_poses(rows) <= MOST_POSES else thin_poses(rows, MOST_POSES)


def _extrapolate_to_all_rows(judged: Testability, library: Library, share: float) -> Testability:
    """What all rows would show, where a ``share`` of them was looked at: amplitudes fall with the root of the rows."""
    smallest = judged.smallest * np.sqrt(share)
    limit = np.array([max(abs(p.lower), abs(p.upper)) for p in library.parameters])
    return replace(judged, smallest=smallest, able=np.isfinite(smallest) & (smallest <= limit))
