"""Where a version is less sure than its parameters say: boxes of joint values, each with an error that nothing explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.types import Bools, Floats


@dataclass(frozen=True)
class Doubt:
    """A box of joint values ``low (n,)`` to ``high (n,)``, rad or m, infinite where a joint bounds it not.

    ``error_m`` is the length by which the tool may be off there beyond what the version says; ``reason`` says why.
    """

    low: Floats
    high: Floats
    error_m: float
    reason: str

    @staticmethod
    def everywhere(n: int, error_m: float, reason: str) -> Doubt:
        """Return the doubt about a whole version."""
        return Doubt(np.full(n, -np.inf), np.full(n, np.inf), error_m, reason)

    @property
    def whole(self) -> bool:
        """Whether it is about every pose."""
        return not np.isfinite([self.low, self.high]).any()

    def holds(self, q: Floats) -> Bools:
        """Which joint vectors (N, n) are in the box."""
        return np.asarray(((q >= self.low) & (q <= self.high)).all(axis=1))

    def to_document(self) -> dict[str, Any]:
        """JSON-able, SI; None where a joint bounds the box not."""
        ends = {name: [v if np.isfinite(v) else None for v in getattr(self, name).tolist()] for name in ("low", "high")}
        return {**ends, "error_m": self.error_m, "reason": self.reason}

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Doubt:
        """Rebuild from :meth:`to_document`."""
        low, high = (
            np.array([open_end if v is None else v for v in document[name]], dtype=np.float64)
            for name, open_end in (("low", -np.inf), ("high", np.inf))
        )
        return Doubt(low, high, float(document["error_m"]), str(document["reason"]))


def unexplained_error(doubts: Sequence[Doubt], q: Floats) -> Floats:
    """Return the largest unexplained error (N,) m of the doubts that hold each joint vector (N, n); 0 where none does."""
    out = np.zeros(len(q))
    for doubt in doubts:
        out = np.maximum(out, np.where(doubt.holds(q), doubt.error_m, 0.0))
    return out
