"""Documents that JSON can hold, and rows as a job counts them over all its campaigns."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

import numpy as np


def to_json_types(value: Any) -> Any:
    """Return a document with Python's own types, and None where a number is not finite."""
    if isinstance(value, Mapping):
        return {str(key): to_json_types(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_types(part) for part in value]
    if isinstance(value, np.ndarray):
        return to_json_types(value.tolist())
    if isinstance(value, np.generic):
        return to_json_types(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def by_campaign(rows: Sequence[Mapping[str, Any]], counts: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return rows of all campaigns together, ``row`` from 0, as rows of each, from 1; ``counts`` in their order."""
    names, starts = list(counts), [0, *accumulate(counts.values())]
    out = []
    for one in rows:
        k = bisect_right(starts, one["row"], hi=len(names)) - 1
        out.append({"campaign": names[k], **one, "row": one["row"] - starts[k] + 1})
    return out
