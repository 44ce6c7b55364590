"""Rows that jobs count over all their campaigns, as rows of each."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any


def by_campaign(rows: Sequence[Mapping[str, Any]], counts: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return rows of all campaigns together, ``row`` from 0, as rows of each, from 1; ``counts`` in their order."""
    names, starts = list(counts), [0, *accumulate(counts.values())]
    out = []
    for one in rows:
        k = bisect_right(starts, one["row"], hi=len(names)) - 1
        out.append({"campaign": names[k], **one, "row": one["row"] - starts[k] + 1})
    return out
