"""What the error of an arm is made of: what its version takes away, and what is left today."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from markupsafe import Markup, escape

from kilter_service.contract.fits import StageErrors
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.today import Today
from kilter_service.contract.versions import Version
from kilter_service.page.figures.plot import BLUE, GREEN, GREY, ORANGE, PURPLE, RED, SKY
from kilter_service.page.shared.called import format_claim
from kilter_service.page.shared.steps import steps_shown
from kilter_service.page.words import format_in_largest_unit, list_effects

MEAN_OF_NOISE = math.sqrt(8.0 / math.pi)  # mean length of a vector whose three coordinates have sigma 1
OF_THE_FIT = "residuals of the fit"  # a noise that is not known apart
WIDE, HIGH = 560.0, 40.0
EFFECTS = (GREEN, PURPLE, SKY)


@dataclass(frozen=True)
class Share:
    """A part of the error, mm; ``taken``: the version takes it away; ``probable``: not every test of it was passed."""

    name: str
    size: float
    colour: str
    taken: bool
    probable: bool = False


@dataclass(frozen=True)
class Budget:
    """The parts, in the order in which the model grew."""

    shares: Sequence[Share]

    @property
    def most(self) -> float:
        """All of them together, mm."""
        return sum(one.size for one in self.shares)

    def svg(self) -> Markup:
        """Draw the parts as one stacked bar; what is only probable is hatched."""
        parts, x = [], 0.0
        for one in self.shares:
            wide = WIDE * one.size / self.most
            fill = f'fill="{one.colour}"' + ("" if not one.taken else ' fill-opacity="0.55"')
            told = f"<title>{escape(one.name)}: {format_in_largest_unit(one.size, self.most)}</title>"
            parts.append(
                f'<rect x="{x:.1f}" y="0" width="{max(wide - 1, 0.5):.1f}" height="{HIGH:g}" {fill}>{told}</rect>'
            )
            lines = range(int(x) + 4, int(x + wide), 7) if one.probable else ()
            parts += [f'<path d="M{at} {HIGH:g}l6 -{HIGH:g}" class="hatch"/>' for at in lines]
            x += wide
        words = "; ".join(f"{one.name} {format_in_largest_unit(one.size, self.most)}" for one in self.shares)
        head = f'<svg viewBox="0 0 {WIDE:g} {HIGH:g}" role="img" class="budget"><title>Budget of the error</title>'
        return Markup(f"{head}<desc>{escape(words)}</desc>{''.join(parts)}</svg>")  # noqa: S704 (texts are escaped above)


def error_budget(today: Today, version: Version | None, search: GapResult | None) -> Budget | None:
    """Return what the error is made of; ``search`` made the version. None where its own job gave no errors."""
    if version is None or today.own is None or today.newest is None:
        return None
    shares = [one for one in _shares(today, version, search) if one.size > 0.0]
    return Budget(shares) if shares else None


def _shares(today: Today, version: Version, search: GapResult | None) -> Iterator[Share]:
    assert today.own is not None
    assert today.newest is not None
    own, newest = today.own.errors, today.newest.errors
    assert own.identified is not None
    assert newest.identified is not None
    nominal, registered = _mean(own, "nominal"), _mean(own, "registration_only")
    rigid = own.best_rigid.mean_mm if own.best_rigid is not None else None
    left = own.identified.mean_mm
    if nominal is not None and registered is not None and own.place_mm is None:
        yield Share("base and tool", nominal - registered, GREY, True)
    if registered is not None:
        yield Share("geometry", registered - (left if rigid is None else rigid), BLUE, True)
    if rigid is not None:
        yield from _effects(rigid - left, version, search)
    now = newest.identified.mean_mm
    if today.changed or now > 1.5 * left:
        yield Share("changed since the fit", now - left, RED, False)
    known = version.details.noise_source not in (None, OF_THE_FIT)  # else all that is left counts as noise there
    noise = min(MEAN_OF_NOISE * (version.noise_mm or 0.0), left, now) if known else 0.0
    yield Share("left, cause not known" if known else "left, with the noise", min(left, now) - noise, ORANGE, False)
    yield Share("noise of the measurement", noise, GREY, False)


def _effects(gain: float, version: Version, search: GapResult | None) -> Iterator[Share]:
    """Each effect by the step that it took in its search, else all of a version together."""
    steps = None if search is None else steps_shown(search.figures, "mm")
    named = [] if search is None else search.effects or []
    if steps is None or len(steps.steps) != len(named) + 1:
        yield Share(list_effects(version.effects).replace("_", " "), gain, GREEN, True)
        return
    errors = [one.fitted if one.held_out is None else one.held_out for one in steps.steps]
    drops = [max(before - after, 0.0) for before, after in pairwise(errors)]
    whole = sum(drops) or 1.0
    for place, (effect, drop) in enumerate(zip(named, drops, strict=True)):
        share = Share(format_claim(effect), gain * drop / whole, EFFECTS[place % len(EFFECTS)], True)
        yield replace(share, probable=effect.verdict in ("provisional", "class_confirmed"))


def _mean(errors: StageErrors, name: str) -> float | None:
    found = getattr(errors, name)
    return None if found is None else float(found.mean_mm)
