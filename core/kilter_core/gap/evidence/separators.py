"""Evidence that separates a named effect from the others of its physical class, tested on the data (trap 16).

A shape that repeats does not prove a cause: torsion of a link is the gear of the next joint, a hose is a scale error, and
whatever went with time is a drift. What separates a member is a condition that the others of its class do not follow, so
the part of the effect that follows this condition must be seen by itself, and be of the same amplitude as the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from scipy.stats import rankdata

from kilter_core.effects.laws import SHARES, settled_share
from kilter_core.effects.physical import JOINT_ZERO, STATION, THERMAL, Separator, joint_numbers
from kilter_core.gap.evidence.fits.final_fit import amounts, final_effect_amounts
from kilter_core.gap.evidence.revisits import revisits
from kilter_core.gap.evidence.similarity.smooth import TURN
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.gram import Projection, orthonormal
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.linear.settings import library_parameters
from kilter_core.gap.search.scan import residual_given
from kilter_core.gap.search.sources.source import Source
from kilter_core.observations import Observations
from kilter_core.observations.clock import read_clock
from kilter_core.parameters import display_unit_and_scale
from kilter_core.types import Bools, Floats

# What went with the clock: whether poses were measured in random order, and else which joint, height or load rose
# with it.
#
# A law of time may be named where nothing that follows the posture can be what went with it. Neighbours in the space
# of the joints, of the tool, or along any one of them are then neighbours in time no more often than in a shuffled
# order, and none of them rises or falls with the clock. Polynomials of the posture are too poor for this: what a
# climbing arm leaves of them still goes along with the clock.

NEIGHBOURS = 4  # visits nearest to one that say when it was
SHUFFLES = 400  # of the clock
RANDOM = 0.01  # chance of a random order beyond which it is taken for one
FEWEST_VISITS = 20  # below which no order is called random
LOOKED_AT = 2000  # visits at most
GOES_ALONG = 0.3  # rank correlation with the clock that is worth a word
SPREAD = 1e-6  # rad or m: what varies less does not vary

SENSOR_ALONE = 3.0  # standard deviations in which a sensor must show the effect, or must have been able to
SENSOR_ALIKE = 0.5  # share of what the tool says by which a reading may differ: its scale and its mounting are rough
AXES = 3  # channels of an inclinometer
SENSED = (STATION.id, JOINT_ZERO.id, THERMAL.id)


@dataclass(frozen=True)
class Order:
    """Chance of neighbours so near in time in a random order, and what ``went`` along most, with its rank correlation."""

    chance: float
    visits: int
    went: str
    correlation: float

    @property
    def random(self) -> bool:
        """Whether nothing of the posture can have gone with the clock."""
        return self.visits >= FEWEST_VISITS and self.chance > RANDOM

    @property
    def words(self) -> str:
        """What went with the clock, for people."""
        if abs(self.correlation) < GOES_ALONG:
            return "poses near each other were measured one after another"
        verb = "rose" if self.correlation > 0.0 else "fell"
        return f"{self.went} {verb} with the clock (correlation {self.correlation:.2f})"


def assess_visit_order(source: Source, used: Bools, seed: int = 0) -> Order:
    """Compare the order of the visits used with shuffles of it."""
    rng = np.random.default_rng(seed)
    visits = np.flatnonzero(used)
    if len(visits) > LOOKED_AT:
        visits = np.sort(rng.choice(visits, LOOKED_AT, replace=False))
    when = np.empty(len(used))
    when[read_clock(source.observations).order] = np.arange(len(used))
    clock = rankdata(when[visits])
    single, whole = _postures(source)
    single = {name: x[visits] for name, x in single.items() if np.ptp(x[visits]) > SPREAD}
    along = {name: float(np.corrcoef(clock, rankdata(x))[0, 1]) for name, x in single.items()}
    went = max(along, key=lambda name: abs(along[name]), default="")
    spaces = [*(x[:, None] for x in single.values()), *(x[visits] for x in whole)]
    chance = _chance(clock, spaces, rng) if len(visits) > 2 * NEIGHBOURS else 0.0
    return Order(chance, len(visits), went, along.get(went, 0.0))


def _postures(source: Source) -> tuple[Mapping[str, Floats], tuple[Floats, ...]]:
    """What may go with the clock: single numbers (V,) by name, and whole spaces (V, k)."""
    rows, tool = source.observations, source.batch.tool_point
    single = {f"joint {j + 1}": rows.q[:, j] for j in range(rows.q.shape[1])}
    single |= {
        "the height of the tool": tool[:, 2],
        "the reach of the tool": np.hypot(tool[:, 0], tool[:, 1]),
        "x of the tool": tool[:, 0],
        "y of the tool": tool[:, 1],
    }
    if rows.payload_kg is not None:
        single["the payload"] = rows.payload_kg
    if rows.direction is not None:
        single |= {f"the approach of joint {j + 1}": rows.direction[:, j] for j in range(rows.q.shape[1])}
    return single, (rows.q, tool)


def _chance(clock: Floats, spaces: list[Floats], rng: np.random.Generator) -> float:
    """Share of shuffles in which some space goes along with time as the real order does, or more.

    By neighbours, which see any function of the posture, and by rank, which sees a weak trend better.
    """
    c = (clock - clock.mean()) / max(float(clock.std()), 1e-300)
    shuffled = np.stack([c, *(rng.permutation(c) for _ in range(SHUFFLES))])
    beyond = []
    for space in spaces:
        ranks = np.stack([rankdata(x) for x in space.T], axis=1)
        near = np.sum((_means(space, rng) @ shuffled.T).T * shuffled, axis=1)
        along = np.abs(shuffled @ (ranks - ranks.mean(axis=0))).T
        beyond += [(x - x[1:].mean()) / max(float(x[1:].std()), 1e-300) for x in (near, *along)]
    most = np.max(beyond, axis=0)
    return float((1 + np.sum(most[1:] >= most[0])) / (1 + SHUFFLES))


def _means(space: Floats, rng: np.random.Generator) -> csr_array:
    """Matrix (V, V) of the mean over the neighbours of each visit; ties are broken by chance."""
    x = space / np.maximum(space.std(axis=0), 1e-12)
    x = x + 1e-6 * rng.normal(size=x.shape)
    near = np.asarray(KDTree(x).query(x, NEIGHBOURS + 1)[1])[:, 1:]
    rows = np.repeat(np.arange(len(x)), NEIGHBOURS)
    return csr_array((np.full(near.size, 1.0 / NEIGHBOURS), (rows, near.reshape(-1))), shape=(len(x), len(x)))


ALONE = 3.0  # standard deviations in which the part that follows the condition must show by itself
ALIKE = 3.0  # standard deviations within which its amplitude must be that of the rest
COURSE = 3  # degree of the polynomial of time that a temperature must leave, beside settlings of every pace


@dataclass(frozen=True)
class Separated:
    """Whether a piece of evidence separates the name from its class, the number that says so, and what is ``told`` of it.

    ``against`` says that it refutes the name.
    """

    separator: Separator
    met: bool
    number: float | None = None
    told: str = ""
    against: bool = False


def separating_evidence(search: SearchResult, place: int) -> tuple[Separated, ...]:
    """Test for what a chosen name needs beside its shape; empty where nothing but its rivals can take it away."""
    candidate = search.selector.scorer.candidates[place]
    robot = search.problem.settings.source.model.robot
    wanted = dict.fromkeys(s for effect in candidate.effects for s in effect.separators(robot))
    found = tuple(TESTS[one](search, place) for one in wanted)
    if Separator.SENSOR in wanted:
        return found
    asked = _sensor(search, place)  # no name waits for a sensor that is not there, and none stands against one that is
    return (*found, asked) if asked.met or asked.against else found


def _turns(search: SearchResult, place: int) -> Separated:
    source = search.problem.settings.source
    q, joints = source.batch.q, source.model.robot.joints
    followed = [x for e in search.selector.scorer.candidates[place].effects for x in e.joint_frequencies(len(joints))]
    turns = min(
        (factor * float(np.ptp(q[:, j])) / TURN if joints[j].kind == "revolute" else 0.0 for j, factor in followed),
        default=0.0,
    )
    return Separated(Separator.TURN, turns >= 1.0, turns)


# In positions wind-up by friction and backlash are one column. Torques know the friction of a joint, and loads its
# compliance: where a reversal is as large as their product, friction winds the joint up; where it is far larger, it cannot.
REVERSALS = {
    "backlash": ("backlash", 0.5),
    "friction_windup": ("windup", 1.0),
}  # parameter, and how much of it is wind-up
MOST_FRICTION = 0.5  # share of a reversal that friction may be where backlash is named


def compare_with_friction(found: SearchResult, place: int) -> tuple[str, float, str] | None:
    """Return which of wind-up and backlash torques single out for a chosen reversal, how surely, and both numbers in words.

    None where they leave it open: a smaller reversal (friction on the motor's side winds up nothing), or one that is friction
    in part, or a joint that runs ahead of its motor.
    """
    candidate, source = found.selector.scorer.candidates[place], found.problem.settings.source
    friction = source.model.robot.told_friction
    if candidate.id not in REVERSALS or friction is None:
        return None
    told, library, (name, part) = final_effect_amounts(found), library_parameters(source), REVERSALS[candidate.id]
    at = {library[column].name: n for n, column in enumerate(found.columns)}
    members, words, sure = set(), [], np.inf
    for j in candidate.joints or ():
        wanted = (f"{name}_{j + 1}", f"compliance_{j + 1}")
        if not at.keys() >= {*wanted}:
            return None
        places = [at[one] for one in wanted]
        (reversal, c), C, (F, sigma) = told.values[places], told.covariance[np.ix_(places, places)], friction[j]
        seen, by = -part * reversal, np.array([-part, -F])
        unsure, product = np.sqrt(by @ C @ by + (c * sigma) ** 2), np.hypot(F * np.sqrt(C[1, 1]), c * sigma)
        if not (seen > ALONE * unsure and c * F > ALONE * product):
            return None
        alike, far = abs(seen - c * F) <= ALONE * unsure, c * F < MOST_FRICTION * seen
        members.add("friction_windup" if alike else "backlash" if far else "")
        unit, scale = display_unit_and_scale("rad" if source.model.robot.joints[j].kind == "revolute" else "m")
        one, other = (
            with_sigma(scale * c * F, scale * product),
            with_sigma(scale * seen, scale * part * np.sqrt(C[0, 0])),
        )
        words.append(f"friction times compliance of joint {j + 1} is {one} {unit}, half of its reversal {other} {unit}")
        sure = min(sure, float(c * F / product))
    member = members.pop() if len(members) == 1 else ""
    return (member, sure, "; ".join(words)) if member else None


def _friction(search: SearchResult, place: int) -> Separated:
    found = compare_with_friction(search, place)
    if found is None:
        return Separated(Separator.FRICTION, False)
    own = found[0] == search.selector.scorer.candidates[place].id
    return Separated(Separator.FRICTION, own, found[1], found[2], not own)


def _loads(search: SearchResult, place: int) -> Separated:
    rows = search.problem.settings.source.observations
    if rows.payload_kg is not None and np.ptp(rows.payload_kg) > 0.0:
        return _separate_by_condition(search, place, Separator.LOADS, replace(rows, payload_kg=np.zeros(len(rows))))
    if rows.loads_on_links_vary:
        return _separate_by_condition(search, place, Separator.LOADS, replace(rows, link_mass=None, link_wrench=None))
    return Separated(Separator.LOADS, False)


def _temperature(search: SearchResult, place: int) -> Separated:
    rows = search.problem.settings.source.observations
    if rows.temperature_c is None:
        return Separated(Separator.TEMPERATURE, False)
    clock = np.arange(len(rows), dtype=np.float64) if rows.t is None else rows.t
    x = (clock - clock.min()) / (float(np.ptp(clock)) or 1.0)
    laws = np.column_stack([np.vander(x, COURSE + 1), *(settled_share(x, tau) for tau in SHARES)])
    course = laws @ np.linalg.lstsq(laws, rows.temperature_c, rcond=None)[0]
    return _separate_by_condition(search, place, Separator.TEMPERATURE, replace(rows, temperature_c=course))


def _order(search: SearchResult, place: int) -> Separated:
    """Poses that were revisited tell time from what went with it; without them a random order of all poses does."""
    settings = search.problem.settings
    seen = revisits(search, place)
    told = "no pose was revisited at another time" if seen is None else "revisits at other times are too few to tell"
    if seen is not None:
        unit, scale = display_unit_and_scale(settings.source.unit)
        size = seen.predicted * scale
        vary = f"{seen.poses} poses revisited at other times vary by {with_sigma(seen.slope * size, seen.sigma * size)} {unit}"
        whose = "the other poses predict" if seen.held_out else "the law says"
        if seen.alone > ALONE and seen.deviation_in_sigmas < ALIKE:
            return Separated(Separator.ORDER, True, seen.alone, f"{vary}, and {whose} {size:.2g} {unit}")
        if seen.sharp:
            told = f"{vary}, where {whose} {size:.2g} {unit}"
    order = assess_visit_order(settings.source, settings.used)
    if order.random and not (seen is not None and seen.sharp):
        return Separated(Separator.ORDER, True, order.chance, "the poses were measured in random order")
    number = None if seen is None else seen.alone
    return Separated(Separator.ORDER, False, number, f"{told}; {order.words}")


def _sensor(search: SearchResult, place: int) -> Separated:
    """What a link encoder at the joint, or an inclinometer on the base, reads of it."""
    seen = compare_with_sensor(search, place)
    if seen is None or not (seen.supports_effect or seen.refutes_effect):
        return Separated(Separator.SENSOR, False)
    return Separated(
        Separator.SENSOR, seen.supports_effect, seen.slope / seen.sigma, seen.comparison_text, seen.refutes_effect
    )


def _separate_by_condition(search: SearchResult, place: int, separator: Separator, without: Observations) -> Separated:
    """The effect in two parts, as it would be under the conditions ``without`` and what the real ones add, each fitted.

    Both have the coefficient 1 where the effect is what its name says.
    """
    problem = search.problem
    settings, columns = problem.settings, list(search.selector.scorer.candidates[place].columns)
    amounts = settings.source.library(problem.values)[columns]
    source = settings.source.without_geometry()
    other = source.on_rows(without).batch
    parts = [
        settings.whitening.columns(source.linear(problem.values, batch, columns).W) @ amounts
        for batch in (other, source.batch)
    ]
    both = np.stack([parts[0], parts[1] - parts[0]], axis=1)
    rest = search.selector.columns([k for k in search.chosen if k != place])
    basis = orthonormal(problem.projected_columns(rest)) if rest else np.zeros((len(both), 0))
    left = Projection.from_columns(problem.soft, problem.U, both).less(basis).rows(slice(None))
    return _compare_part_amplitudes(
        separator, left, residual_given(problem, rest), search.selector.variance(problem.gram, search.chosen)
    )


def _compare_part_amplitudes(separator: Separator, parts: Floats, r: Floats, variance: float) -> Separated:
    """Whether the second of two parts (R, 2) shows by itself and as large as the first."""
    size = np.linalg.norm(parts, axis=0)
    shown = size > 1e-6 * max(float(size.max()), 1e-300)
    if not shown[1]:
        return Separated(separator, False, 0.0)
    kept = parts[:, shown] / size[shown]
    inverse = np.linalg.pinv(kept.T @ kept, rcond=1e-9, hermitian=True)
    scale = 1.0 / size[shown]
    amount, covariance = (inverse @ (kept.T @ r)) * scale, variance * inverse * np.outer(scale, scale)
    alone = float(amount[-1] / max(float(np.sqrt(covariance[-1, -1])), 1e-300))
    if len(amount) == 1:
        return Separated(separator, alone > ALONE, alone)
    apart = abs(amount[1] - amount[0]) / np.sqrt(max(float(np.array([-1, 1]) @ covariance @ [-1, 1]), 1e-300))
    return Separated(separator, alone > ALONE and bool(apart < ALIKE), alone)


TESTS: Mapping[Separator, Callable[[SearchResult, int], Separated]] = {
    Separator.TURN: _turns,
    Separator.LOADS: _loads,
    Separator.FRICTION: _friction,
    Separator.TEMPERATURE: _temperature,
    Separator.ORDER: _order,
    Separator.SENSOR: _sensor,
}


# What a sensor at the place itself says of a named effect: an inclinometer on the base, an encoder on the link.
# That a column is there proves nothing. The effect is fitted to the tool alone, and what the sensor must then read is
# compared with what it reads: an arm that climbed with the clock got a drift a hundred times what its own
# inclinometer saw.


@dataclass(frozen=True)
class Sensed:
    """By how much an effect rotates the place of a ``sensor`` as the tool says (rad or m, largest change), and what it reads.

    ``slope`` is what is read over what the tool says, ``read`` its standard deviation by the readings and ``known`` that
    by what the tool tells.
    """

    sensor: str
    expected: float
    slope: float
    read: float
    known: float
    slides: bool = False

    @property
    def sigma(self) -> float:
        """Standard deviation of the slope."""
        return float(np.hypot(self.read, max(1.0, abs(self.slope)) * self.known))

    @property
    def able(self) -> bool:
        """Whether the sensor would show an effect of this size."""
        return self.sigma * SENSOR_ALONE < 1.0

    @property
    def supports_effect(self) -> bool:
        """Whether it shows the effect, by sign and size."""
        return self.slope > SENSOR_ALONE * self.sigma and self._slope_error <= max(
            SENSOR_ALIKE, SENSOR_ALONE * self.sigma
        )

    @property
    def refutes_effect(self) -> bool:
        """Whether it would show the effect, and does not."""
        return self.able and self._slope_error > max(SENSOR_ALIKE, SENSOR_ALONE * self.sigma)

    @property
    def comparison_text(self) -> str:
        """Both numbers in words."""
        unit, scale = display_unit_and_scale("m" if self.slides else "rad")
        size = scale * self.expected
        shown, said = with_sigma(self.slope * size, self.read * size), with_sigma(size, self.known * size)
        return f"{self.sensor} shows {shown} {unit} where the tool says {said} {unit}"

    @property
    def _slope_error(self) -> float:
        return abs(self.slope - 1.0)


def with_sigma(value: float, sigma: float) -> str:
    """A value and its standard deviation, for people, to the first digit of that."""
    digits = max(0, -math.floor(math.log10(max(sigma, 1e-9))))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def compare_with_sensor(search: SearchResult, place: int) -> Sensed | None:
    """Compare the readings with a chosen candidate; None where no sensor sits where it acts, or it rotates nothing there."""
    problem, candidate = search.problem, search.selector.scorer.candidates[place]
    source, columns = problem.settings.source, list(candidate.columns)
    channels = _channels(search, candidate)
    if not len(channels):
        return None
    amount, covariance = _by_tool(search, place)
    W = source.without_geometry().linear(problem.values, None, columns).W
    by = W[:, channels].reshape(-1, len(columns))
    read = source.residual(problem.values)[:, channels].reshape(-1) + by @ source.library(problem.values)[columns]
    used = np.repeat(problem.settings.used, len(channels)) & np.isfinite(read)
    told, read, by = (by @ amount)[used], read[used], by[used]
    size = float(told @ told)
    if size <= 0.0 or len(read) < 2 * len(channels):
        return None
    slope = float(told @ read) / size
    scatter = float(np.sum((read - slope * told) ** 2)) / max(len(read) - 1, 1)
    along = by.T @ told
    read_sigma, known = np.sqrt(max(scatter, 1e-300) / size), np.sqrt(float(along @ covariance @ along)) / size
    where = [np.ptp((W[:, k] @ amount)[problem.settings.used]) for k in channels]
    slides = candidate.joints is not None and all(
        source.model.robot.joints[j].kind == "prismatic" for j in candidate.joints
    )
    return Sensed(_name(candidate), float(np.linalg.norm(where)), slope, float(read_sigma), float(known), slides)


def _channels(search: SearchResult, candidate: Candidate) -> list[int]:
    """Numbers of a visit that sensors read where a candidate acts."""
    source = search.problem.settings.source
    if not source.tool_numbers or not source.observes_tool or candidate.effects[0].physical.id not in SENSED:
        return []
    rows, n = source.observations, source.model.robot.n_joints
    seen = np.any(~np.isnan(source.residual(search.problem.values)), axis=0).tolist()
    if candidate.joints is not None:
        numbers: Sequence[int] = [source.tool_numbers + j for j in candidate.joints] if rows.link_q is not None else []
    elif rows.tilt is not None and rows.tilt.shape[1] > n:
        numbers = range(len(seen) - AXES, len(seen))  # the base comes last
    else:
        numbers = []
    return [k for k in numbers if seen[k]] if candidate.joints is None or all(seen[k] for k in numbers) else []


def _by_tool(search: SearchResult, place: int) -> tuple[Floats, Floats]:
    """Parameters (K,) of a candidate by the tool's numbers alone, with its prior, and their covariance (K, K)."""
    problem: LinearizedProblem = search.problem
    columns = list(search.selector.scorer.candidates[place].columns)
    rest = search.selector.columns([k for k in search.chosen if k != place])
    basis = problem.basis(rest)
    W = problem.projected_columns(columns)
    X = W - basis @ (basis.T @ W)
    size = problem.settings.whitener.shape[-1]
    tool = np.arange(len(X)) % size < problem.settings.source.tool_numbers
    X, r = X[tool], residual_given(problem, rest, basis)[tool]
    amount, covariance = amounts(search, columns, X, r)
    scale = problem.scale[columns]
    return scale * amount, covariance * np.outer(scale, scale)


def _name(candidate: Candidate) -> str:
    if candidate.joints is None:
        return "the inclinometer on the base"
    return f"the link encoder of {joint_numbers(candidate.joints)}"
