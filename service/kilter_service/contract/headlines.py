"""The answer first: what a result says in one to three lines, and a row of a table for each effect that it names.

Every surface shows what is made here. It is made of the numbers of the result, so results of earlier releases have it too.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from pydantic import Field

from kilter_service.contract.devices import PixelsFound
from kilter_service.contract.figures import NextPose, ToldApart
from kilter_service.contract.fits import Metrics, Noise, Parameter
from kilter_service.contract.gap_details import Adequacy, Amplitude, GapNoise, GapSize, MotionFound, NamedEffect
from kilter_service.contract.units import Mm, Stored

HEADLINE = "The answer in one to three lines: what was found, how large the error is, what is not proven."
Sure = Literal["certain", "probable", "open"]
ORDER: tuple[Sure, ...] = ("certain", "probable", "open")
SURE: dict[str | None, Sure] = {
    "replicated": "certain",
    "confirmed": "certain",
    "class_confirmed": "certain",
    "provisional": "probable",
}
CERTAIN_VERDICTS = ("closed", "no_gap")  # of a run: nothing else is significant
SHAPELESS = ("joint_curve", "station", "thermal")  # classes whose members' shapes say nothing more
UNNAMED = 20  # rivals that do as well, from which none of them says anything, as in kilter_core's Claim
MOST_NAMED = 3  # of one degree in a headline
AT_JOINTS = re.compile(r"joints? \d+(?:, \d+)*")
JOINT = re.compile(r"_(\d+)$")
MILLIONTHS = {"1": "ppm", "1/K": "ppm/K"}  # units of small shares, as people write them
SMALL = 1e-3  # share below which they do
PLAIN = {
    "friction_windup": "friction wind-up",
    "base_step": "a move of base or instrument",
    "tool_step": "a move of tool or marker",
    "stribeck": "Stribeck friction",
    "root_speed": "friction by the root of the speed",
    "quadratic_speed": "friction by the square of the speed",
}  # names that a person would not use with spaces alone
MEAN_LENGTH = math.sqrt(8.0 / math.pi)  # of noise in space, in standard deviations of a coordinate (Maxwell)
NEAR, FAR = 1.5, 2.0  # times the noise: what is left is noise; or something is missing


class Found(Stored):
    """An effect that was found, as a row of a table for people."""

    effect: str = Field(description="What it is: a member by its name, or its class where the member is not settled.")
    joints: list[int] | None = Field(None, description="Joints it is said of, from 1; null: it does not act at joints.")
    size: str = Field("", description="Range of its 95 % intervals over the joints, with its unit; empty: none.")
    moves_mm: Mm | None = Field(None, description="Rms movement of the tool by it, mm; null: joint data.")
    sure: Sure = Field(description="`certain`, `probable` or `open`.")


@dataclass(frozen=True)
class _Row:
    """An effect at some joints; ``words`` has {} where its joints are named, ``low`` and ``high`` end its intervals."""

    words: str
    sure: Sure
    joints: tuple[int, ...]
    unit: str = ""
    low: float = math.nan
    high: float = math.nan
    moves: float = 0.0

    @property
    def size(self) -> str:
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            return ""
        if self.unit in MILLIONTHS and max(abs(self.low), abs(self.high)) < SMALL:
            return f"{format_range(1e6 * self.low, 1e6 * self.high)} {MILLIONTHS[self.unit]}"
        return f"{format_range(self.low, self.high)} {'' if self.unit == '1' else self.unit}".strip()

    @property
    def noun(self) -> str:
        """The effect without its joints."""
        words = self.words if " or of {}" in self.words else self.words.replace(" of {}", "")
        return words.format("the joint")

    @property
    def name(self) -> str:
        """The effect with its joints."""
        return self.words.format(format_joints(self.joints))

    @property
    def phrase(self) -> str:
        """The effect with joints and size, as a part of a sentence."""
        size = self.size or (f"{number(self.moves)} mm at the tool" if self.moves else "")
        return f"{self.name} ({size})" if size else self.name


def format_joints(joints: Sequence[int]) -> str:
    """Write joints as people say them: "joint 2", "joints 2-5", "joints 1, 3-5"."""
    runs: list[list[int]] = []
    for joint in sorted(set(joints)):
        if runs and joint == runs[-1][-1] + 1:
            runs[-1].append(joint)
        else:
            runs.append([joint])
    parts = [f"{run[0]}-{run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs]
    return f"joint{'s' if len(set(joints)) > 1 else ''} {', '.join(parts)}"


def format_range(low: float, high: float) -> str:
    """Write a range rounded outward, to two digits of its larger end; to at most two more where it is narrower than these."""
    largest, width = max(abs(low), abs(high)), high - low
    places = 1 - math.floor(math.log10(largest)) if largest else 0
    if width > 0.0:
        places += min(max(-math.floor(math.log10(width)) - places, 0), 2)
    step = 10.0**-places
    ends = [math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step]
    first, last = (f"{end + 0.0:.{max(places, 0)}f}" for end in ends)
    return first if first == last else f"{first}-{last}" if low >= 0.0 else f"{first} to {last}"


def list_found(effects: Iterable[NamedEffect]) -> list[Found]:
    """Return a row for each effect of a search, the surest and largest first; the same at several joints is one."""
    return [
        Found(
            effect=row.noun, joints=list(row.joints) or None, size=row.size, moves_mm=row.moves or None, sure=row.sure
        )
        for row in _rows(effects)
    ]


def name_effects(effects: Iterable[NamedEffect]) -> list[str]:
    """Return the names of effects with their joints, as a headline has them; the same at several joints is one."""
    return [row.name for row in _rows(effects)]


def _rows(effects: Iterable[NamedEffect]) -> list[_Row]:
    merged: dict[tuple[str, str, str, bool], _Row] = {}
    for row in (row for effect in effects for row in _rows_of_effect(effect)):
        key = row.words, row.sure, row.unit, bool(row.joints)
        if (known := merged.get(key)) is None or not row.joints:
            merged[(*key[:2], f"{row.unit} {len(merged)}", key[3]) if known else key] = row
            continue
        merged[key] = replace(
            known,
            joints=tuple(sorted({*known.joints, *row.joints})),
            low=min(known.low, row.low),
            high=max(known.high, row.high),
            moves=max(known.moves, row.moves),
        )
    return sorted(merged.values(), key=lambda row: (ORDER.index(row.sure), -row.moves))


def _rows_of_effect(effect: NamedEffect) -> Iterator[_Row]:
    """An effect at the joints it is claimed of; where the data do not show it, it is open."""
    sure: Sure = "open" if effect.empirical else SURE.get(effect.verdict, "open")
    claimed = effect.claim.joints if effect.claim is not None else None
    joints = set(claimed or effect.joints or ())
    if effect.joints and claimed == [] and sure == "certain":  # certain of the arm, of none of its joints
        sure = "probable"
    seen = joints & set(effect.seen_joints) if effect.seen_joints else joints
    yield _row(effect, tuple(sorted(seen)), sure)
    if unseen := joints - seen:
        yield _row(effect, tuple(sorted(unseen)), "open")


def _row(effect: NamedEffect, joints: tuple[int, ...], sure: Sure) -> _Row:
    amounts = [one for one in effect.parameters or () if not joints or _joint(one) in joints]
    amounts = [one for one in amounts if one.unit == amounts[0].unit]  # of a mass with its moments, the mass
    units = {one.unit or "" for one in amounts}
    moves = effect.moves_mm or 0.0
    words = _words(effect) + (f" in {effect.campaign}" if effect.campaign else "")
    words += " (contradicted by unseen poses)" if effect.verdict == "contradicted" else ""
    plain = _Row(words, sure, joints, moves=moves)
    if len(units) != 1 or len(amounts) != max(len(joints), 1):
        return plain
    ends = [(one.interval_low, one.interval_high) for one in amounts]
    if any(low is None or high is None for low, high in ends):
        return plain
    lows, highs = zip(*ends, strict=True)
    return replace(plain, unit=units.pop(), low=min(lows), high=max(highs))


def _joint(amount: Amplitude) -> int | None:
    found = JOINT.search(amount.name)
    return int(found[1]) if found else None


def _words(effect: NamedEffect) -> str:
    """The narrowest set that the data single out, with {} for the joints: never a member where only its class is settled."""
    own, claim = _plain(effect.id), effect.claim
    rivals = [one for one in dict.fromkeys(_plain(a.id) for a in effect.alias_set or ()) if one != own]
    at = " of {}" if effect.joints else ""
    if effect.empirical or (claim is not None and claim.said == "member") or (claim is None and not rivals):
        return own + at
    if claim is not None and claim.said == "class" and effect.physical_class is not None:
        if len(rivals) >= UNNAMED:
            return "an effect that these data cannot name"
        about = effect.physical_class
        label = AT_JOINTS.sub("{}", about.label.replace("{", "").replace("}", ""), count=1)
        if about.id in SHAPELESS:
            return label
        return f"{label}, like {_list_alternatives(own, rivals)}"
    return _list_alternatives(own, rivals) + at


def _list_alternatives(own: str, rivals: Sequence[str]) -> str:
    more = f" or {len(rivals) - 1} others" if len(rivals) > 2 else ""
    return " or ".join([own, *rivals[: 1 if more else 2]]) + more


def _plain(effect: str) -> str:
    """The name of an effect as a person says it."""
    return PLAIN.get(effect, effect.replace("_", " "))


def describe_search(
    verdict: str | None,
    effects: Sequence[NamedEffect],
    gap: GapSize | None,
    adequacy: Adequacy | None,
    noise: GapNoise | None,
    poses: Sequence[NextPose],
    told_apart: ToldApart | None,
) -> str:
    """Return the headline of a gap search: what was found, the error before and after, what is not proven and what decides."""
    rows = _rows(effects)
    by_sure = {sure: [row for row in rows if row.sure == sure] for sure in ORDER}
    lines = [
        _describe_certain(verdict, by_sure["certain"], bool(rows), adequacy),
        _describe_gap(gap, adequacy, noise, verdict),
        " ".join(_describe_undecided(verdict, by_sure, adequacy, effects, poses, told_apart)),
    ]
    return "\n".join(line for line in lines if line)


def describe_motion(effects: Sequence[NamedEffect], motion: MotionFound) -> str:
    """Return the headline of a search in torques: what was found, what it leaves of torques never used, what is open."""
    rows = _rows(effects)
    by_sure = {sure: [row for row in rows if row.sure == sure] for sure in ORDER}
    moved = [one for one in motion.joints if not one.at_rest]
    best = max(moved, key=lambda one: 1.0 - one.found / max(one.friction, 1e-12), default=None)
    where = "motions that were never used" if motion.unseen else "the last third of the one motion"
    lines = [
        f"Found: {_join(by_sure['certain'])}."
        if by_sure["certain"]
        else "Nothing is certain yet."
        if rows
        else "Rigid bodies with Coulomb and viscous friction are all that this log shows."
    ]
    if best is not None:
        lines.append(
            f"Torque error of joint {best.joint} on {where}: {number(best.friction)} -> {number(best.found)} {best.unit} rms "
            f"(rigid bodies alone: {number(best.rigid)} {best.unit})."
        )
    if by_sure["probable"]:
        lines.append(f"Probable, not proven: {_join(by_sure['probable'])}.")
    weak = next((one for one in effects if SURE.get(one.verdict) != "certain" and one.to_confirm), None)
    if weak is not None and weak.to_confirm:
        lines.append(f"To decide: {weak.to_confirm[0]}")
    return "\n".join(lines)


def _describe_certain(verdict: str | None, certain: Sequence[_Row], named: bool, adequacy: Adequacy | None) -> str:
    if certain:
        rest = " Nothing else is significant." if verdict in CERTAIN_VERDICTS else ""
        return f"Found: {_join(certain)}.{rest}"
    if verdict in CERTAIN_VERDICTS:
        return "Nothing that matters is missing: the model agrees with the measurements within their noise."
    if verdict == "not_known":
        return "Nothing was found. Whether something is missing is open: the noise is not known apart from the fit."
    if named:
        return "Nothing is certain yet."
    return f"Something is missing{_describe_remainder(adequacy)}, and no known effect explains it."


def _join(rows: Sequence[_Row]) -> str:
    said = [row.phrase for row in rows[:MOST_NAMED]]
    said += [f"{len(rows) - MOST_NAMED} more"] if len(rows) > MOST_NAMED else []
    return said[0] if len(said) == 1 else f"{'; '.join(said[:-1])}; and {said[-1]}"


def _describe_gap(gap: GapSize | None, adequacy: Adequacy | None, noise: GapNoise | None, verdict: str | None) -> str:
    if gap is None:
        return ""
    unit = "mm" if gap.before_deg is None else "deg"
    size = gap.model_dump()
    shown = f"{unit} by views" if gap.lengths == "by_views" else unit
    held = "validation_" if size.get(f"validation_after_{unit}") is not None else ""
    before, after = size.get(f"{held}before_{unit}"), size.get(f"{held}after_{unit}")
    if before is None or after is None:
        return ""
    unseen = None if adequacy is None or adequacy.held_out is None else adequacy.held_out.poses
    where = (
        f"{unseen} unseen poses" if held and unseen else "held-out poses" if held else "the poses that were searched"
    )
    every = size.get(f"validation_after_all_{unit}")
    aside = f" ({number(every)} {unit} with {gap.held_out_set_aside} set aside)" if held and every is not None else ""
    said = f"Error on {where}: {number(before)} -> {number(after)} {shown} rms{aside}."
    floor = size.get(f"noise_rms_{unit}")
    if floor is None or noise is None or noise.absolute is False:
        return said if verdict == "not_known" else f"{said} The noise is not known apart from the fit."
    return f"{said} Measurement noise: {number(floor)} {shown}."


def _describe_undecided(
    verdict: str | None,
    by_sure: dict[Sure, list[_Row]],
    adequacy: Adequacy | None,
    effects: Sequence[NamedEffect],
    poses: Sequence[NextPose],
    told_apart: ToldApart | None,
) -> Iterator[str]:
    if by_sure["probable"]:
        yield f"Probable, not proven: {_join(by_sure['probable'])}."
    if by_sure["open"]:
        yield f"Open: {_join(by_sure['open'])}."
    if verdict == "unexplained" and any(by_sure.values()):
        yield f"Open: something else remains{_describe_remainder(adequacy)} that no known effect explains."
    weak = [one for one in effects if SURE.get(one.verdict) != "certain"]
    if told_apart is not None and told_apart.instead and not told_apart.enough:
        yield f"To decide: {told_apart.instead[0].replace('_', ' ')}."
        return
    asked = Counter(one.change or "measure new poses" for one in poses if one.information_factor is not None)
    if asked:
        change, count = asked.most_common(1)[0]
        yield f"To decide: {change} ({count} poses; `kilter gap` with `--poses next.csv` writes them)."
    elif weak and weak[0].to_confirm:
        yield f"To decide: {weak[0].to_confirm[0]}"


def _describe_remainder(adequacy: Adequacy | None) -> str:
    if adequacy is None:
        return ""
    unseen = adequacy.held_out
    left = unseen.left_mm if unseen is not None and unseen.refuted else adequacy.misfit_mm
    return "" if not left else f" ({number(left)} mm rms)"


def describe_fit(
    metrics: Metrics | None,
    parameters: Sequence[Parameter],
    noise_mm: float | None,
    noise: Noise | None,
    pixels: PixelsFound | None = None,
) -> str:
    """Return the headline of an identification: the error before and after, how it compares with the noise, what is open."""
    held = None if metrics is None else metrics.validation
    errors = held or (None if metrics is None else metrics.train)
    if errors is None or errors.identified is None:
        return _describe_views(pixels) or ("No tool was measured: see the parameters." if parameters else "")
    before, n = errors.registration_only or errors.nominal, f"{errors.n} " if errors.n else ""
    aside = f" ({errors.left_out} more set aside)" if errors.left_out else ""
    where = f"{n}unseen rows{aside}" if held is not None else f"the {n}rows that were fitted (no pose was held out)"
    fell = "" if before is None else f"{number(before.mean_mm)} -> "
    fitted = " Before: nominal arm, base and tool fitted." if errors.registration_only is not None else ""
    lines = [f"Mean error on {where}: {fell}{number(errors.identified.mean_mm)} mm.{fitted}"]
    times = count_noise_left(metrics, noise_mm, noise)
    lines.append(_compare_with_noise(times, noise_mm) if times is not None and noise_mm else "")
    unknown = [one.name for one in parameters if one.identifiable is False and not one.from_prior]
    if unknown:
        lines.append(f"Open: {len(unknown)} of {len(parameters)} parameters, which these poses cannot determine.")
    return "\n".join(line for line in lines if line)


def describe_masses(search: str | None, torques: str | None = None) -> str:
    """Return the lines of a headline that say which searches in torques masses, and the torques of paths, come from."""
    masses = "" if search is None else f"\nMasses and centres of the links are from torques: search {search}."
    return masses if torques is None else f"{masses}\nTorques of paths are told by search {torques}."


def _describe_views(pixels: PixelsFound | None) -> str:
    """The error of the tool by views, where nothing else measured it."""
    if pixels is None:
        return ""
    tool, where = pixels.validation or pixels.train, "held out" if pixels.validation else "that were fitted"
    between = format_range(tool.low_mm, tool.high_mm)
    return f"Error of the tool in views {where}: {number(tool.rms_mm)} mm rms (95 %: {between} mm)."


def count_noise_left(metrics: Metrics | None, noise_mm: float | None, noise: Noise | None) -> float | None:
    """Return how many times the noise is left, both as mean lengths in space; None: no repeats of points tell the noise."""
    held = None if metrics is None else metrics.validation or metrics.train
    errors = None if held is None else held.identified
    if errors is None or errors.x_mm is None or errors.y_mm is None or errors.z_mm is None:
        return None
    repeats = noise is not None and noise.between_visits_mm is not None
    return errors.mean_mm / (MEAN_LENGTH * noise_mm) if repeats and noise_mm else None


def _compare_with_noise(times: float, noise_mm: float) -> str:
    said = f"Measurement noise: {number(MEAN_LENGTH * noise_mm)} mm."
    if times <= NEAR:
        return f"{said} What is left is about the noise."
    if times < FAR:
        return said
    return f"{said} Something is missing: {number(times)} times the noise is left. `kilter gap` looks for it."


def number(value: float) -> str:
    """Write a number with two significant digits and without an exponent, a large one to the unit."""
    if not value or not math.isfinite(value):
        return f"{value:g}"
    return f"{value:.{min(max(1 - math.floor(math.log10(abs(value))), 0), 9)}f}"
