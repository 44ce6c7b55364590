"""Masses and centres as the robot states them and as the data leave them: which of them the data could see."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kilter_core.arm.loads.slopes import EACH, LIGHTEST_KG, links_with_mass, with_masses
from kilter_core.effects.masses import LoadError
from kilter_core.identify.identifiable.identifiability import identifiable
from kilter_core.model import Calibration
from kilter_core.parameters import MM
from kilter_core.types import Floats

FAR = 3.0  # prior sigmas from what was stated: one mass in 400 by chance, if the sigmas are true
NAMED = {"mass": "mass", "com_x": "centre along x", "com_y": "centre along y", "com_z": "centre along z"}


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


def far_from_stated(rows: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Warn of masses that the data pull far from what was stated: they are wrong, or stand for something else."""
    far = [row for row in rows if abs(row["value"] - row["stated"]) > FAR * row["prior_sigma"]]
    if not far:
        return
    said = "; ".join(_describe_deviation(row) for row in far)
    yield {
        "code": "mass_far_from_stated",
        "masses": [{key: row[key] for key in ("link", "parameter", "unit", "stated", "value")} for row in far],
        "message": f"{said}: more than {FAR:g} standard deviations of what was stated. {_remedy(far)} If they are right, "
        "another effect of the load is missing.",
    }


def _describe_deviation(row: Mapping[str, Any]) -> str:
    body = "the payload" if row["link"] is None else f"link {row['link']}"
    name = NAMED.get(row["parameter"], f"place along tool {row['parameter'][-1]}")
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
