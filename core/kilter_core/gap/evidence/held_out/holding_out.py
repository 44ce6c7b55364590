"""Which poses a search never sees: held out before anything is chosen, so that they can judge what was.

Leave-one-out after a selection is not held out: the same poses chose the name. Of pure noise the best of all candidates
gains on poses left out one at a time in 92 % of campaigns.
"""

from __future__ import annotations

import numpy as np

from kilter_core.effects.other_campaigns import placed_later
from kilter_core.errors import ObservationError, OptionError
from kilter_core.identify.holdout import split
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import group_contacts, placements
from kilter_core.observations import Observations
from kilter_core.observations.shared_rows import refuse_shared_rows
from kilter_core.types import Ints

SHARE = 0.25  # of the poses, held out when nothing else is asked
POSES_TO_SPARE_SOME = 60  # poses from which so many can be spared
FEWEST_PLACEMENTS = 4  # of contacts, from which one can be spared unasked


def held_out_share(rows: Observations, validation: float | None) -> float:
    """Share of the poses that is held out; None asks for a quarter where there are 60 poses or more, 0 for none.

    Of contacts whole placements are held out, unasked where there are four or more.
    """
    if validation is not None:
        if not 0.0 <= validation < 1.0:
            raise OptionError(
                f"validation is {validation}: give a fraction from 0 (nothing held out) to below 1.",
                option="validation",
            )
        return float(validation)
    placed = placements(rows)
    if placed is not None and len(placed[1]) < FEWEST_PLACEMENTS:
        return 0.0
    return SHARE if len(rows) and int(rows.pose_groups().max()) + 1 >= POSES_TO_SPARE_SOME else 0.0


def held_out(rows: Observations, validation: float | None, seed: int) -> tuple[Ints, Ints]:
    """Row indices (train, held out), the same that an identification holds out of these rows with this share and seed.

    Raises:
        OptionError: a fraction outside [0, 1). TooFewPosesError: a side without poses.

    """
    share = held_out_share(rows, validation)
    if share == 0.0:
        return np.arange(len(rows)), np.zeros(0, dtype=np.int64)
    return split(rows, share, seed)


def split_held_out_rows(
    rows: Observations, validation: Observations | float | None, seed: int
) -> tuple[Observations, Observations | None]:
    """Rows to search and rows that take no part in it, None without any.

    Raises:
        ObservationError: ``rows_shared``, where other observations repeat rows that are searched. OptionError: a
        fraction outside [0, 1).

    """
    if isinstance(validation, Observations):
        refuse_shared_rows(rows, validation, "validation")
        _refuse_other_contacts(rows, validation)
        return rows, placed_later(validation)
    inside, outside = held_out(rows, validation, seed)
    return (rows, None) if not len(outside) else (rows.select(inside), rows.select(outside))


def _refuse_other_contacts(rows: Observations, validation: Observations) -> None:
    """Refuse validation rows whose tool was measured otherwise where contacts held either, and contacts too small to judge.

    Raises:
        ObservationError: what cannot judge what, and the remedy.

    """
    widths = [{3 if c.kind == "socket" else 1 for c in group_contacts(part)} for part in (rows, validation)]
    if widths[0] != widths[1]:
        raise ObservationError(
            "The rows to search and those to validate measure the tool in different ways: sockets, planes and bars, or an "
            "instrument. Name a campaign of the same kind to validate, and this one as the confirmation.",
            code="contacts_mixed",
        )
    if widths[1]:
        Measurement.from_observations(validation, held=True)
