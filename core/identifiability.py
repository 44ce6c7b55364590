"""What the data can and cannot tell: null directions by name, and how far each parameter is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Below these shares of prior variance removed a direction rests on the prior, not on the data.
BLIND = 0.5
STRUCTURAL = 1e-6


@dataclass(frozen=True)
class NullDirection:
    """A combination of parameters that the poses do not see. Weights are in units of each parameter's prior sigma."""

    weights: tuple[tuple[str, float], ...]
    learned: float
    structural: bool

    def sentence(self) -> str:
        """Say the direction in words."""
        named = ", ".join(f"{name} ({weight:+.2f})" for name, weight in self.weights)
        if len(self.weights) == 1:
            return f"{self.weights[0][0]} cannot be identified from these poses; it keeps its starting value."
        return f"These move together without any measured effect: {named}. Their start decides how they share it."


def null_directions(J: Floats, names: Sequence[str], prior_sigma: Floats) -> tuple[NullDirection, ...]:
    """Directions of the whitened Jacobian ``J (R, P)`` that the data do not fix.

    Columns are scaled by the prior sigma, so a singular value s says that the data shrink the prior variance of that
    direction by 1 / (1 + s²). Directions with s² / (1 + s²) below one half are reported, the weakest first.
    """
    scaled = J * prior_sigma
    _, s, Vt = np.linalg.svd(np.linalg.qr(scaled, mode="r") if len(scaled) > len(names) else scaled, full_matrices=True)
    s = np.concatenate([s, np.zeros(len(names) - len(s))])
    learned = s**2 / (1.0 + s**2)
    top = max(float(s[0]), 1.0) if len(s) else 1.0
    out = []
    for k in np.flatnonzero(learned < BLIND)[::-1]:
        v = Vt[k] * np.sign(Vt[k][np.argmax(np.abs(Vt[k]))])
        order = np.argsort(-np.abs(v))
        kept = tuple((names[i], float(v[i])) for i in order if abs(v[i]) > 0.15)[:8]
        out.append(NullDirection(kept, float(learned[k]), bool(s[k] < STRUCTURAL * top)))
    return tuple(out)


def identifiable(posterior_sigma: Floats, prior_sigma: Floats) -> NDArray[np.bool_]:
    """Whether the data removed at least half of each parameter's prior variance."""
    return np.asarray((posterior_sigma / prior_sigma) ** 2 < BLIND)
