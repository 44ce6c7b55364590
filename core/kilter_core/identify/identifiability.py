"""What the data can and cannot tell: unobservable directions by name, and how far each parameter is known.

Masses and centres as the robot states them and as the data leave them: which of them the data could see.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.arm.load_slopes import EACH, LIGHTEST_KG, links_with_mass, with_masses
from kilter_core.effects.masses import LoadError
from kilter_core.errors import FindingDocument
from kilter_core.model import Calibration
from kilter_core.parameters import MM
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


FAR = 3.0  # prior sigmas from what was stated: one mass in 400 by chance, if the sigmas are true
NAMED_LOADS = {"mass": "mass", "com_x": "centre along x", "com_y": "centre along y", "com_z": "centre along z"}


@dataclass(frozen=True)
class Stated:
    """A number of a body as stated or told, in the unit of the robot document, and what one unit of its error is there."""

    link: int | None  # from 1; None: the payload
    parameter: str
    unit: str
    stated: float
    scale: float  # of its error
    sigma_scale: float  # of its sigmas: centres are stated for the stated mass

    def row(self, error: float, sigma: float, prior: float, seen: bool) -> dict[str, Any]:
        """As the result lists it."""
        return {
            "link": self.link,
            "parameter": self.parameter,
            "unit": self.unit,
            "stated": self.stated,
            "value": self.stated + error * self.scale,
            "sigma": sigma * self.sigma_scale,
            "prior_sigma": prior * self.sigma_scale,
            "seen": seen,
        }


def load_rows(
    calibration: Calibration, names: Sequence[str], sigma: Floats, prior_sigma: Floats
) -> list[dict[str, Any]]:
    """A row for each mass and each coordinate of a centre among the free parameters ``names`` (their sigmas (F,), SI).

    ``seen`` is that of every other parameter: the data took three quarters of the prior variance, so that sigma is half
    of what it was at most. Less is mostly the prior itself.
    """
    model, place = calibration.model, {name: k for k, name in enumerate(names)}
    known = identifiable(sigma, prior_sigma)
    out = []
    for effect, where in zip(model.effects, model.effect_slices().values(), strict=True):
        if not isinstance(effect, LoadError):
            continue
        errors = calibration.values[where]
        own = effect.parameters(model.robot)
        beyond = errors - [p.value for p in own]
        for p, error, one in zip(own, beyond, _stated_load_values(calibration, effect, beyond), strict=True):
            if p.name in place:
                k = place[p.name]
                out.append(one.row(float(error), float(sigma[k]), float(prior_sigma[k]), bool(known[k])))
    return out


def _stated_load_values(calibration: Calibration, effect: LoadError, errors: Floats) -> Iterator[Stated]:
    """What the robot, its torques and the rows say of each body, in the order of the errors beyond that.

    A first moment is a centre times the mass.
    """
    told = [p.value for p in effect.parameters(calibration.robot)]
    robot = with_masses(calibration.robot, told)
    for n, k in enumerate(links_with_mass(robot)):
        link = robot.links[k]
        mass = max(link.mass + float(errors[EACH * n]), LIGHTEST_KG)
        yield Stated(k + 1, "mass", "kg", link.mass, 1.0, 1.0)
        for axis, at in zip("xyz", link.com, strict=True):
            yield Stated(k + 1, f"com_{axis}", "mm", float(at) * MM, MM / mass, MM / link.mass)
    if effect.payload_kg > 0.0:
        yield Stated(None, "mass", "kg", effect.payload_kg, 1.0, 1.0)
        yield from (Stated(None, f"shift_{axis}", "mm", 0.0, MM, MM) for axis in "xyz")


def far_from_stated(rows: Sequence[Mapping[str, Any]]) -> Iterator[FindingDocument]:
    """Warn of masses that the data pull far from what was stated: they are wrong, or stand for something else."""
    far = [row for row in rows if abs(row["value"] - row["stated"]) > FAR * row["prior_sigma"]]
    if not far:
        return
    said = "; ".join(_describe_deviation(row) for row in far)
    yield FindingDocument.make(
        "mass_far_from_stated",
        f"{said}: more than {FAR:g} standard deviations of what was stated. {_remedy(far)} If they are right, "
        "another effect of the load is missing.",
        masses=[{key: row[key] for key in ("link", "parameter", "unit", "stated", "value")} for row in far],
    )


def _describe_deviation(row: Mapping[str, Any]) -> str:
    body = "the payload" if row["link"] is None else f"link {row['link']}"
    name = NAMED_LOADS.get(row["parameter"], f"place along tool {row['parameter'][-1]}")
    return (
        f"The {name} of {body} comes out as {row['value']:.4g} {row['unit']} instead of {row['stated']:.4g} ± "
        f"{row['prior_sigma']:.2g}"
    )


def _remedy(far: Sequence[Mapping[str, Any]]) -> str:
    wrong = {row["link"] is None for row in far}
    fields = {
        False: "Weigh these links and their neighbours, for which they may stand in, and correct mass_kg and com_mm of the "
        "robot (or mass_sigma_kg and com_sigma_mm).",
        True: "Weigh the payload, and upload the rows with its payload_kg and place (or correct payload_sigma of the robot).",
    }
    return " ".join(fields[k] for k in sorted(wrong))
