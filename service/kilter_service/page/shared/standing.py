"""How a robot stands: its errors in a few numbers, what corrects it, its state, and what its error is made of."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

from markupsafe import Markup, escape

from kilter_service.contract.fits import Errors, Metrics, StageErrors
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.streams import Bridge
from kilter_service.contract.today import UNUSED, Standing, Today
from kilter_service.contract.versions import Version
from kilter_service.contract.wording import interval, widest
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.page.figures.plot import BLUE, GREEN, GREY, ORANGE, PURPLE, RED, SKY, whole_svg
from kilter_service.page.shared.errors_drawn import steps_shown
from kilter_service.page.shared.naming import format_claim
from kilter_service.page.words import format_in_largest_unit, list_effects
from kilter_service.robots.compensation import CORRECTS, WORDS
from kilter_service.stream import bridges as known_bridges
from kilter_service.versions import metrics as observability
from kilter_service.versions.today.standing import largest
from kilter_service.web import health


@dataclass(frozen=True)
class Accuracy:
    """Errors of a version on ``stages.n`` points, mm; ``low`` and ``high`` are the ends of the 95 % interval of the mean.

    The interval takes the points as independent. Without held-out rows the errors are those of the fit, which look too good.
    """

    held_out: bool
    mean: float
    p95: float | None
    low: float | None
    high: float | None
    stages: StageErrors  # of all models
    widest: float  # the largest of the errors that stand beside the mean: its unit is that of all
    unused: bool = False  # of rows that no fit used, and not of those that its own job held out

    def of(self, stage: str) -> float | None:
        """Return what another model leaves, mm: ``nominal``, ``registration_only``, ``best_rigid``."""
        return _mean_mm(self.stages, stage)

    @property
    def without(self) -> float:
        """The largest error of the version and of what simpler models leave, mm."""
        return max(one for one in (self.mean, self.of("registration_only"), self.of("nominal")) if one is not None)


def accuracy_from_metrics(metrics: Metrics) -> Accuracy | None:
    """Read the errors on held-out poses, else those on the rows that were fitted; None when no tool was measured."""
    for held_out, block in ((True, metrics.validation), (False, metrics.train)):
        if block is not None and block.identified is not None:
            return _read(held_out, block, block.identified)
    return None


def accuracy_today(today: Today) -> Accuracy | None:
    """Read the newest errors of a robot, in the unit of the sentences on them; None when nothing is known."""
    newest = today.newest
    if newest is None or newest.errors.identified is None:
        return None
    found = _read(newest.source != "fitted", newest.errors, newest.errors.identified)
    return replace(found, unused=newest.source in UNUSED, widest=largest(newest, today.own))


def _read(held_out: bool, block: StageErrors, found: Errors) -> Accuracy:
    low, high = interval(found, block.n) or (None, None)
    return Accuracy(held_out, found.mean_mm, found.p95_mm, low, high, block, widest(found, block.n))


OFF = "Not corrected"
BRIDGED = "By a bridge"
OTHER = "Other version"
TWICE = "Corrected twice"
LIVE_S = 10
UNCORRECTED = ("refusing", "holding back", "fading out", "off")  # states of a bridge whose offsets go out, or are out


@dataclass(frozen=True)
class Correcting:
    """``look`` is the badge's: good, warn, bad or faint."""

    word: str
    look: str
    sentence: str
    instead: str = ""  # the state of a robot whose active version is not what its setpoints are corrected with


@dataclass(frozen=True)
class Corrector:
    """The corrector process as the health of the server has it, and what its streams last said."""

    state: health.ProcessState
    detail: str
    streams: Sequence[Mapping[str, Any]]
    bridges: Mapping[str, Sequence[Bridge]] = field(default_factory=dict)

    def describe_correction(self, robot: str, active: str | None, compensation: str = "unknown") -> Correcting:
        """Say what it does for a robot, whose active version is given, and what its controller does by itself."""
        running = [one for one in self.bridges.get(robot, ()) if not one.gone]
        twice = next((one for one in running if one.corrected_twice), None)
        if twice is not None:  # what the controller does by itself must not hide it
            return Correcting("corrected twice", "bad", twice.sentence, TWICE)
        newest = next(iter(self.bridges.get(robot, ())), None)
        lost = newest if newest is not None and newest.gone and newest.state != "ended" else None
        if compensation in CORRECTS and lost is not None and _offset_joints(lost):  # it may go on where it runs
            return Correcting("bridge gone", "warn", lost.sentence, "Perhaps twice")
        if compensation in CORRECTS:
            said = f"The controller {WORDS[compensation]}, so its setpoints are not corrected a second time."
            return Correcting("by the controller", "faint", said, "By its controller")
        if running:  # it corrects by itself, whether or not the corrector runs
            return _of_bridge(running[0], active)
        if lost is not None and not any(one["robot"] == robot for one in self.streams):
            return Correcting("bridge gone", "bad", lost.sentence, OFF)
        if self.state == "starting":
            return Correcting("starting", "warn", f"The corrector {self.detail}: setpoints are not corrected yet.", OFF)
        if self.state == "stopped":
            return Correcting("corrector stopped", "bad", f"The corrector does not run: {self.detail}.", OFF)
        if active is None:
            return Correcting(
                "bypassed", "warn", "No version is active: every setpoint is refused, and nothing is corrected."
            )
        mine = [one for one in self.streams if one["robot"] == robot]
        if not mine:
            return Correcting(
                "ready", "faint", "The corrector runs. No controller has sent it setpoints of this robot."
            )
        others = {one["version_id"] for one in mine} - {active}
        names = ", ".join(str(one["stream"]) for one in mine)
        if others:
            used = ", ".join(sorted(str(one or "no version") for one in others))
            said = f"Stream {names} last corrected with {used}, not the active one."
            # One that ended before the version was activated says nothing of the next setpoint.
            goes_on = any(one["version_id"] in others and _is_live(one) for one in mine)
            return Correcting("other version", "warn", said, OTHER if goes_on else "")
        if not any(_is_live(one) for one in mine):
            return Correcting(
                "ready", "faint", f"Stream {names} was corrected with the active version; it sends nothing now."
            )
        return Correcting("streaming", "good", f"Stream {names} is corrected with the active version.")


def corrector(database: Database, settings: Settings) -> Corrector:
    """Look at the corrector."""
    check = health.report(database, settings).checks.get("corrector")
    return Corrector(
        check.state if isinstance(check, health.ProcessCheck) else "stopped",
        "it was not looked at" if check is None else check.detail,
        observability.streams(database),
        known_bridges.of_robots(database),
    )


def _offset_joints(bridge: Bridge) -> bool:
    """Whether the joints were offset when it was last heard."""
    return bridge.state in known_bridges.OFFSETTING or bridge.offset_deg > 0.0


def _is_live(stream: Mapping[str, Any]) -> bool:
    """Whether a stream goes on: it tells each second what it does."""
    return abs(time.time_ns() - int(stream.get("at_ns") or 0)) < LIVE_S * 1_000_000_000


def _of_bridge(bridge: Bridge, active: str | None) -> Correcting:
    """What a bridge does, which runs; it may be told a version, and then corrects without an active one."""
    if bridge.state in ("correcting", "ramping in"):
        if bridge.other_version:
            return Correcting("by a bridge", "warn", bridge.sentence, OTHER if active else BRIDGED)
        return Correcting("by a bridge", "good", bridge.sentence)
    look, instead = "faint" if bridge.state == "waiting" else "warn", OFF if bridge.state in UNCORRECTED else ""
    return Correcting("bridge " + bridge.state, look, bridge.sentence, instead)


LOUDNESS = ("bad", "warn", "faint", "good")


@dataclass(frozen=True)
class State:
    """``look`` is the colour's: good, warn, bad or faint."""

    word: str
    look: str
    sentence: str


def assess_robot_state(today: Today, seen: Correcting) -> State:
    """Say how a robot stands; what is worst is said."""
    standing = today.standing or Standing(state="not_known", words="Not known", sentence="", look="faint")
    instead = bool(seen.instead) and not (standing.state == "uncalibrated" and seen.instead == OFF)
    if seen.instead == TWICE or (instead and standing.look != "bad"):
        return State(seen.instead, seen.look, seen.sentence)
    return State(standing.words, standing.look, standing.sentence)


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
        return whole_svg(WIDE, HIGH, parts, "Budget of the error", words, more='class="budget"')


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
    nominal, registered = _mean_mm(own, "nominal"), _mean_mm(own, "registration_only")
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


def _mean_mm(errors: StageErrors, name: str) -> float | None:
    found = getattr(errors, name)
    return None if found is None else float(found.mean_mm)
