"""Which poses a search never sees: held out before anything is chosen, so that they can judge what was.

Leave-one-out after a selection is not held out: the same poses chose the name. Of pure noise the best of all candidates
gains on poses left out one at a time in 92 % of campaigns.
"""

from __future__ import annotations

import numpy as np

from kilter_core.errors import ObservationError, OptionError
from kilter_core.identify.holdout import split
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import contacts_of, placements
from kilter_core.observations import Observations
from kilter_core.observations.motions import is_trajectory
from kilter_core.types import Ints

SHARE = 0.25  # of the poses, held out when nothing else is asked
POSES_TO_SPARE_SOME = 60  # poses from which so many can be spared
FEWEST_PLACEMENTS = 4  # of contacts, from which one can be spared unasked
SAME_ROW = 1e-7  # m or rad: rows closer than this in all that was measured are one row, whatever unit they came in
COINCIDENCE = 0.01  # share of the rows of a motion that may be the same: an arm at rest reads the same twice


def share_of(rows: Observations, validation: float | None) -> float:
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
    share = share_of(rows, validation)
    if share == 0.0:
        return np.arange(len(rows)), np.zeros(0, dtype=np.int64)
    return split(rows, share, seed)


def parted(
    rows: Observations, validation: Observations | float | None, seed: int
) -> tuple[Observations, Observations | None]:
    """Rows to search and rows that take no part in it, None without any.

    Raises:
        ObservationError: ``rows_shared``, where other observations repeat rows that are searched. OptionError: a
        fraction outside [0, 1).

    """
    if isinstance(validation, Observations):
        refuse_shared(rows, validation, "validation")
        _refuse_other_contacts(rows, validation)
        return rows, validation
    inside, outside = held_out(rows, validation, seed)
    return (rows, None) if not len(outside) else (rows.select(inside), rows.select(outside))


def refuse_shared(rows: Observations, others: Observations, use: str) -> None:
    """Refuse rows that are searched and judge at once; compared by what they hold, so a second upload counts too.

    Raises:
        ObservationError: ``rows_shared``, with the first of them and the remedy.

    """
    shared = copies(rows, others)
    if not len(shared):
        return
    raise ObservationError(
        f"{len(shared)} of {len(others)} rows for {use} are rows of the search too (row {shared[0] + 1} of the {use} is "
        f"the first). What chose a name cannot judge it: leave these rows out of one of the two, or measure others.",
        code="rows_shared",
    )


def copies(rows: Observations, others: Observations) -> Ints:
    """Rows of ``others`` that are rows of ``rows`` too; none where they are as few as an arm at rest gives by chance."""
    shared = shared_rows(rows, others)
    free = int(COINCIDENCE * len(others)) if is_trajectory(others) else 0
    return shared if len(shared) > free else shared[:0]


def _refuse_other_contacts(rows: Observations, validation: Observations) -> None:
    """Refuse validation rows whose tool was measured otherwise where contacts held either, and contacts too small to judge.

    Raises:
        ObservationError: what cannot judge what, and the remedy.

    """
    widths = [{3 if c.kind == "socket" else 1 for c in contacts_of(part)} for part in (rows, validation)]
    if widths[0] != widths[1]:
        raise ObservationError(
            "The rows to search and those to validate measure the tool in different ways: sockets, planes and bars, or an "
            "instrument. Name a campaign of the same kind to validate, and this one as the confirmation.",
            code="contacts_mixed",
        )
    if widths[1]:
        Measurement.of(validation, held=True)


def shared_rows(rows: Observations, others: Observations) -> Ints:
    """Rows of ``others`` whose joints and measured values are all in a row of ``rows`` too; each content once."""
    one, two = _contents(rows), _contents(others)
    if one.shape[1] != two.shape[1]:
        return np.zeros(0, dtype=np.int64)
    known = {row.tobytes() for row in one}
    first: dict[bytes, int] = {}
    for k, row in enumerate(two):
        first.setdefault(row.tobytes(), k)
    return np.array(sorted(k for row, k in first.items() if row in known), dtype=np.int64)


def _contents(rows: Observations) -> Ints:
    """Joints and measured values (N, c) in steps of ``SAME_ROW``; the time is left out, because a copy may be shifted."""
    contacts = (rows.socket, rows.plane, rows.bar, rows.bar_length)
    values = (rows.position, rows.markers, rows.link_q, *contacts)
    parts = [rows.q, *(v.reshape(len(rows), -1) for v in values if v is not None)]
    whole = np.nan_to_num(np.hstack(parts), nan=1e3)
    return np.ascontiguousarray(np.round(whole / SAME_ROW).astype(np.int64))
