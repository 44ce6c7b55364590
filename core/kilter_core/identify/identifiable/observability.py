"""How well a set of poses determines the parameters together: observability indices, and parameters that go together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from kilter_core.identify.identifiable.identifiability import STRUCTURAL
from kilter_core.types import Floats

CORRELATED = 0.9  # absolute correlation from which two parameters are said to go together


@dataclass(frozen=True)
class Observability:
    """Indices O1 to O5 of the singular values of the Jacobian that are not zero, ``rank`` of ``parameters`` of them."""

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float
    rank: int
    parameters: int

    def to_document(self) -> dict[str, float | int]:
        """Numbers by name; O1, O3, O4 and O5 in the unit of the Jacobian."""
        return {
            "O1": self.o1,
            "O2": self.o2,
            "O3": self.o3,
            "O4": self.o4,
            "O5": self.o5,
            "rank": self.rank,
            "parameters": self.parameters,
        }


def observability(J: Floats, poses: int) -> Observability:
    """Indices of a Jacobian (R, P) whose columns are scaled to be comparable.

    With singular values s_1 >= ... >= s_L and m poses: O1 = (s_1 ... s_L)^(1/L) / sqrt(m) (Borm and Menq),
    O2 = s_L / s_1 (Driels and Pathre), O3 = s_L and O4 = s_L² / s_1 (Nahvi and Hollerbach),
    O5 = 1 / (1/s_1 + ... + 1/s_L) (Sun and Hollerbach). Structural zeros are left out, for they would make all indices
    zero whatever the poses; ``rank`` says how many remain.
    """
    s = np.linalg.svd(np.linalg.qr(J, mode="r") if len(J) > J.shape[1] else J, compute_uv=False)
    seen = s[s > STRUCTURAL * max(float(s.max(initial=0.0)), np.finfo(float).tiny)]
    if len(seen) == 0:
        return Observability(0.0, 0.0, 0.0, 0.0, 0.0, 0, J.shape[1])
    first, last = float(seen[0]), float(seen[-1])
    return Observability(
        o1=float(np.exp(np.mean(np.log(seen)))) / poses**0.5,
        o2=last / first,
        o3=last,
        o4=last**2 / first,
        o5=1.0 / float(np.sum(1.0 / seen)),
        rank=len(seen),
        parameters=J.shape[1],
    )


@dataclass(frozen=True)
class CorrelatedGroup:
    """Parameters linked by correlations of at least ``CORRELATED``; ``strongest`` is the largest of them in size."""

    names: tuple[str, ...]
    strongest: float


def correlated_groups(covariance: Floats, names: Sequence[str], limit: float = CORRELATED) -> list[CorrelatedGroup]:
    """Groups of two or more parameters of a covariance (P, P), the most strongly linked first."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(sigma > 0.0, sigma, 1.0)
    correlation = covariance / np.outer(safe, safe)
    np.fill_diagonal(correlation, 0.0)
    count, label = connected_components(np.abs(correlation) >= limit, directed=False)
    groups = []
    for group in range(count):
        inside = [int(k) for k in np.flatnonzero(label == group)]
        if len(inside) > 1:
            part = correlation[np.ix_(inside, inside)]
            strongest = float(part.reshape(-1)[np.argmax(np.abs(part))])
            groups.append(CorrelatedGroup(tuple(names[k] for k in inside), strongest))
    return sorted(groups, key=lambda g: -abs(g.strongest))
