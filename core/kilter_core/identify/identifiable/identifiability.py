"""What the data can and cannot tell: unobservable directions by name, and how far each parameter is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.types import Bools, Floats, Ints

STRUCTURAL = 1e-7  # singular values below this share of the largest are zero to rounding: no data of these poses help
WEAK = 0.5  # share of prior variance removed below which a direction rests on the prior
KNOWN = 0.75  # share of prior variance removed above which a parameter counts as identified
NAMED = 0.05  # members of a direction below this share of its largest effect are left out of its sentence
ALIKE = 1e-6  # share within which two sizes are alike, so that not rounding but the order of the names decides


@dataclass(frozen=True)
class NullDirection:
    """A combination of parameters that the poses do not see.

    ``weights`` compare what each parameter alone would do to the measurements, the largest being ±1: a move by these
    amounts together cancels. ``structural`` directions are blind whatever the noise; the others are only weak.
    ``amounts`` are the members' own moves, each in its SI unit, to one scale.
    """

    weights: tuple[tuple[str, float], ...]
    learned: float
    structural: bool
    amounts: tuple[float, ...] = ()

    def sentence(self) -> str:
        """Say the direction in words."""
        if len(self.weights) == 1:
            return f"{self.weights[0][0]} has no effect on these measurements; it keeps its starting value."
        first, *others = (name for name, _ in self.weights)
        verb = "cannot be told from" if self.structural else "can hardly be told from"
        return f"{first} {verb} {' and '.join(others) if len(others) < 3 else ', '.join(others)} in these poses."


def null_directions(J: Floats, names: Sequence[str], prior_sigma: Floats) -> tuple[NullDirection, ...]:
    """Directions of the whitened Jacobian ``J (R, P)`` that the data do not fix, structural ones first.

    Columns are scaled by the prior sigma, so a singular value s says that the data shrink the prior variance of that
    direction by 1 / (1 + s²). The structural null space is turned into a basis in which each direction has a parameter
    of its own (pivoted QR), so that aliases read one by one: "d_6 cannot be told from tool_z".
    """
    if not len(names):  # of the arm nothing was free: only cameras were placed
        return ()
    size = np.linalg.norm(J, axis=0)
    scaled = J * prior_sigma
    R = np.linalg.qr(scaled, mode="r") if len(scaled) > len(names) else scaled
    _, s, Vt = np.linalg.svd(R, full_matrices=True)
    s = np.concatenate([s, np.zeros(len(names) - len(s))])
    structural = s <= STRUCTURAL * max(float(s[0]), 1.0)
    out = [_direction(v, names, size, 0.0, True) for v in own_members(Vt[structural]) * prior_sigma]
    learned = s**2 / (1.0 + s**2)
    weak = np.flatnonzero(~structural & (learned < WEAK))[::-1]
    for alike in _group_similar_values(s[weak]):
        for v, k in zip(_own_basis(Vt[weak[alike]]), weak[alike], strict=True):
            out.append(_direction(v * prior_sigma, names, size, float(learned[k]), False))
    return tuple(out)


def identifiable(posterior_sigma: Floats, prior_sigma: Floats) -> Bools:
    """Whether the data removed at least three quarters of each parameter's prior variance.

    Of two parameters that only act together each loses half, so neither counts.
    """
    return np.asarray(1.0 - (posterior_sigma / prior_sigma) ** 2 >= KNOWN)


def _group_similar_values(values: Floats) -> list[Ints]:
    """Places of sorted values (K,), those that are alike together."""
    if len(values) == 0:
        return []
    apart = np.abs(np.diff(values)) > ALIKE * np.maximum(np.abs(values[1:]), np.abs(values[:-1]))
    return np.split(np.arange(len(values)), np.flatnonzero(apart) + 1)


def _own_basis(basis: Floats) -> Floats:
    """Same row space as ``basis (K, P)``: of several directions that are seen alike, any mixture comes out of a processor."""
    if len(basis) < 2:
        return basis
    own = own_members(basis)
    return np.asarray(own / np.linalg.norm(own, axis=1, keepdims=True))


def own_members(basis: Floats) -> Floats:
    """Same row space as orthonormal ``basis (K, P)``, each row with 1 at a parameter where all others have 0.

    Members are chosen as pivoted QR does, the longest column first; of columns of one length the first.
    """
    if len(basis) == 0:
        return basis
    left, own = basis.copy(), []
    for _ in basis:
        length = np.sum(left**2, axis=0)
        own.append(_first_largest(length))
        along = left[:, own[-1]] / np.sqrt(length[own[-1]])
        left -= np.outer(along, along @ left)
    return np.asarray(np.linalg.solve(basis[:, own], basis))


def _first_largest(values: Floats) -> int:
    """Place of the largest value, of those alike the first."""
    return int(np.flatnonzero(values >= (1.0 - ALIKE) * values.max())[0])


def _by_size(values: Floats) -> list[int]:
    """Places of the largest values first, of those alike in their order."""
    order = np.argsort(-values, kind="stable")
    return [int(k) for alike in _group_similar_values(values[order]) for k in np.sort(order[alike])]


def _direction(v: Floats, names: Sequence[str], size: Floats, learned: float, structural: bool) -> NullDirection:
    seen = v * size
    if np.max(np.abs(seen)) <= 1e-9 * np.max(size):  # parameters that move nothing at all: their own amounts must do
        seen = v / np.max(np.abs(v))
    seen = seen / seen[_first_largest(np.abs(seen))]
    order = [i for i in _by_size(np.abs(seen)) if abs(seen[i]) >= NAMED]
    return NullDirection(
        tuple((names[i], float(seen[i])) for i in order), learned, structural, tuple(float(v[i]) for i in order)
    )
