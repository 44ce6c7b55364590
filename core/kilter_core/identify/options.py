"""What can be asked of an identification, checked before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from kilter_core.effects import Effect, effect_from_document
from kilter_core.effects.base import option
from kilter_core.errors import OptionError
from kilter_core.identify.registry import METHODS
from kilter_core.model import RobotModel
from kilter_core.types import Ints

FRAME = ("free", "fixed")
REFERENCES = ("auto", "robot", "registration")
REFERENCE = (
    "Frames that corrections work in: the robot's own, those of the registration, or `auto`: the robot's own for a frame "
    "that is fixed or found within 10 mm and 1 degree of it."
)
MASSES = (
    "`uncertain`: errors of masses and centres are carried beside effects that follow the load, as "
    "`load_error` does; `as_stated`: masses are exact; `auto`: uncertain, but beside an effect that follows the sign of a "
    "load values are fitted with masses as stated, and sigmas hold what their errors do."
)
SEED = "Seed of everything that is drawn by chance, 0 or more."
MOST_SEED = 2**31
FULL_TILTING = ("clearance_tilt", "backlash_load", "axial_compliance")


@dataclass(frozen=True)
class IdentifyOptions:
    """Options of an identification. Those declared with ``option`` are options of the job, too, and of its commands.

    ``effects`` are ids, or documents with options and joints. ``free`` patterns replace the level's geometric parameters,
    ``fix`` patterns hold parameters (``alpha_*``). ``socket_distances_mm`` are known distances between ball
    sockets, {"1-2": 400.0}. ``tilt_first`` holds the effects as in the thesis (4.22, 5.20). ``reference`` says in which
    frames a correction should put the tool where the nominal robot would be: "robot": the measurements were taken in its
    own base and tool; "registration": where the nominal robot fits the measurements best. ``refit`` ("base",) gives every
    campaign and session a base of its own, ("tool",) a tool (a marker that was mounted anew), () one of each to all; None
    leaves the base to the device of the campaign. ``prior`` is that of :mod:`kilter_core.identify.fleet_prior`.
    """

    level: int | None = option(
        None,
        "1 joint offsets, 2 geometry, 3 geometry and effects; null: 3 when `effects` are named, else 2.",
        choices=(1, 2, 3),
    )
    method: str = option("least_squares", "The estimator.", choices=tuple(METHODS))
    tilt_first: bool = option(
        False, "Hold the effects while the geometry is identified: those of the start, else as fitted before it."
    )
    effects: tuple[str | Mapping[str, Any], ...] = ()
    free: tuple[str, ...] = ()
    fix: tuple[str, ...] = ()
    base: str = option(
        "free",
        "Whether the base is fitted; `removed`: only distances between poses count.",
        choices=("free", "fixed", "removed"),
    )
    tool: str = option("free", "Whether the tool is fitted.", choices=FRAME)
    loss: str = option(
        "linear",
        "`huber` bounds what a wrong row can pull, `tukey` sets it aside and names it.",
        choices=("linear", "huber", "tukey"),
    )
    noise_mm: float | None = option(
        None, "Standard deviation of a coordinate, mm, above 0; null: estimated from the rows.", above=0.0
    )
    reference: str = option("auto", REFERENCE, choices=REFERENCES)
    seed: int = option(0, SEED, low=0, high=MOST_SEED)
    search_mm: float = option(25.0, "Half the width of a global search in lengths, mm, above 0.", above=0.0)
    search_deg: float = option(10.0, "Half the width of a global search in angles, degrees, above 0.", above=0.0)
    intervals: str | None = option(
        None,
        "Add 95 % intervals that do not rest on the covariance; null: none.",
        choices=("bootstrap", "profile"),
    )
    socket_distances_mm: Mapping[str, float] = field(default_factory=dict)
    refit: tuple[str, ...] | None = None
    masses: str = option("auto", MASSES, choices=("auto", "uncertain", "as_stated"))
    mass_sigma_percent: float | None = option(
        None, "Standard deviation of every mass, percent of it, above 0; null: what the robot says of each.", above=0.0
    )
    com_sigma_mm: float | None = option(
        None,
        "Standard deviation of each coordinate of every centre of mass, mm, above 0; null: what the robot says.",
        above=0.0,
    )
    prior: str | None = option(
        None,
        "`fleet`: add what versions of at least five other robots of this type say before the rows; null: none of them is "
        "asked.",
        choices=("fleet",),
    )

    @property
    def noise_m(self) -> float | None:
        """Stated standard deviation of a coordinate, m."""
        return None if self.noise_mm is None else self.noise_mm * 1e-3

    @property
    def search_span(self) -> dict[str, float]:
        """Half the box of a global search by unit, m and rad."""
        return {"m": self.search_mm * 1e-3, "rad": math.radians(self.search_deg)}

    @property
    def socket_distances(self) -> dict[tuple[int, int], float]:
        """Known distances between the sockets of each pair, m."""
        pairs = ((pair.split("-"), length) for pair, length in self.socket_distances_mm.items())
        return {(int(a), int(b)): length * 1e-3 for (a, b), length in pairs}

    def __post_init__(self) -> None:
        refuse_undeclared_values(self)
        self._check_method()
        self._check_masses()
        self._check_prior()
        if self.refit is not None and (set(self.refit) - {"base", "tool"} or len(set(self.refit)) < len(self.refit)):
            message = f'refit is {self.refit!r}: give ["base"], ["tool"], ["base", "tool"] or [].'
            raise OptionError(message, option="refit", value=self.refit)
        if not isinstance(self.socket_distances_mm, Mapping):
            raise OptionError(
                'socket_distances_mm is not an object: give {"1-2": 400.0}.', option="socket_distances_mm"
            )
        for pair, value in self.socket_distances_mm.items():
            first, _, second = pair.partition("-")
            if not (first.isdecimal() and second.isdecimal() and first != second and value > 0):
                raise OptionError(
                    f'socket_distances_mm has {pair!r}: {value!r}. Give two socket ids and a length, {{"1-2": 400.0}}.',
                    option="socket_distances_mm",
                )
        if self.level in (1, 2) and self.effects:
            raise OptionError(
                f"Level {self.level} has no effects: drop them, or ask for level 3.", option="level", level=self.level
            )

    def _check_masses(self) -> None:
        """Refuse widths of masses that count as exact."""
        for name in ("mass_sigma_percent", "com_sigma_mm"):
            if getattr(self, name) is not None and self.masses == "as_stated":
                raise OptionError(
                    f"{name} says how well masses are known, masses as_stated that they are exact: leave one of them out.",
                    option=name,
                )

    def _check_prior(self) -> None:
        """Refuse a prior beside a method that knows none, or that continues from a version's own."""
        if self.prior is not None and (self.method != "least_squares" or self.tilt_first):
            other = "tilt_first, which holds effects" if self.method == "least_squares" else f"method {self.method}"
            raise OptionError(
                f"Prior fleet does not go with {other}: leave prior out, or take method least_squares without tilt_first.",
                option="prior",
            )

    def _check_method(self) -> None:
        """Refuse what does not go with the method."""
        method = METHODS[self.method]
        if self.intervals is not None and not method.minimum:
            raise OptionError(
                f"Intervals are those of a least-squares minimum, which {self.method} does not end at. Leave intervals "
                "out, or take method least_squares.",
                option="intervals",
            )
        if self.loss == "tukey" and not method.lets_rows_go:
            fitting = " or ".join(name for name, other in METHODS.items() if other.lets_rows_go)
            raise OptionError(
                f'Loss "tukey" goes with method {fitting}, not with {self.method}: take loss "huber".',
                option="loss",
            )

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> IdentifyOptions:
        """Build options from a JSON object.

        Raises:
            OptionError: an option that does not exist or cannot be.

        """
        return IdentifyOptions(**known_options(IdentifyOptions, "identify", document))

    def make_effects(self) -> tuple[Effect, ...]:
        """Effects of the model: those asked for, or full tilting at level 3."""
        chosen: Sequence[str | Mapping[str, Any]] = self.effects or (FULL_TILTING if self.level == 3 else ())
        return tuple(effect_from_document({"id": e} if isinstance(e, str) else e) for e in chosen)

    def free_parameters(self, model: RobotModel, *, observes_orientation: bool, observes_base: bool = True) -> Ints:
        """Indices of the parameters to identify in ``model``.

        Raises:
            OptionError: a pattern that matches nothing, or nothing left to identify.

        """
        names = set(self._geometric(model))
        names |= {f"base_{k}" for k in FRAME_NAMES} if self.base == "free" and observes_base else set()
        names |= (
            {f"tool_{k}" for k in FRAME_NAMES if observes_orientation or len(k) == 1} if self.tool == "free" else set()
        )
        if not self.tilt_first:
            names |= set(model.names[model.n_geometric :])
        names -= set(_matching(model.names, self.fix)) - self._instrument_parameters(model)
        if not names:
            raise OptionError("Nothing is left to identify: free a parameter, the base or the tool.", option="fix")
        return np.array([k for k, name in enumerate(model.names) if name in names], dtype=np.int64)

    def _instrument_parameters(self, model: RobotModel) -> set[str]:
        """What stands somewhere to measure: a pattern that does not begin with its name does not hold it."""
        seen = [e for e in model.effects if e.instrument is not None]
        names = {p.name for e in seen for p in e.parameters(model.robot)}
        held = [p for p in self.fix if p.startswith(("camera_", "board_"))]
        return names - set(_matching(model.names, held))

    def _geometric(self, model: RobotModel) -> list[str]:
        chain = model.robot.chain
        if self.free:
            return _matching(model.names, self.free)
        wanted = [chain.elements[k] for k in chain.named_elements]
        return [str(e.name) for e in wanted if (e.joint is not None if self.level == 1 else not e.dependent)]


def refuse_undeclared_values(options: Any) -> None:
    """Refuse values of a dataclass of options that their declarations do not allow.

    Raises:
        OptionError: not one of the choices, not a number, or out of its range.

    """
    for one in fields(options):
        value = getattr(options, one.name)
        if "text" in one.metadata and not (value is None and "None" in str(one.type)):
            wanted = _describe_unmet(value, str(one.type), one.metadata)
            if wanted:
                raise OptionError(f"{one.name} is {value!r}: give {wanted}.", option=one.name, value=value)


def _describe_unmet(value: Any, kind: str, declared: Mapping[str, Any]) -> str:
    """What an option takes that a value is not; empty: it is allowed."""
    if "choices" in declared:
        return "" if value in declared["choices"] else ", ".join(map(str, declared["choices"]))
    if "bool" in kind:
        return "" if isinstance(value, bool | np.bool_) else "true or false"
    whole = "int" in kind
    if isinstance(value, bool) or not isinstance(value, int | np.integer if whole else int | float | np.number):
        return "a whole number" if whole else "a number"
    low, above, high, below = (declared.get(limit) for limit in ("low", "above", "high", "below"))
    under = (low is not None and not value >= low) or (above is not None and not value > above)
    over = (high is not None and not value <= high) or (below is not None and not value < below)
    if not (under or over):
        return ""
    if low is not None and high is not None:
        return f"a number from {low} to {high}"
    limits = {"{} or more": low, "above {}": above, "at most {}": high, "below {}": below}
    return "a number " + " and ".join(words.format(limit) for words, limit in limits.items() if limit is not None)


def known_options(options: type, job: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a class of options from a JSON object, lists as tuples.

    Raises:
        OptionError: an option that does not exist.

    """
    known = {f.name for f in fields(options)}
    unknown = sorted(set(document) - known)
    if unknown:
        raise OptionError(f"{job} has no option {unknown[0]!r}. It has: {', '.join(sorted(known))}.", option=unknown[0])
    return {k: tuple(v) if isinstance(v, list) else v for k, v in document.items()}


FRAME_NAMES = ("x", "y", "z", "rx", "ry", "rz")


def _matching(names: Sequence[str], patterns: Sequence[str]) -> list[str]:
    out: list[str] = []
    known = set(names)
    for pattern in patterns:
        found = [pattern] if pattern in known else [name for name in names if fnmatchcase(name, pattern)]
        if not found:
            raise OptionError(
                f"No parameter is named {pattern!r}. There are: {', '.join(names)}.", option="free/fix", pattern=pattern
            )
        out += found
    return out
