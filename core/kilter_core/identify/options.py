"""What can be asked of an identification, checked before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from kilter_core.effects import Effect, effect_from_document
from kilter_core.errors import OptionError
from kilter_core.identify.registry import METHODS
from kilter_core.model import RobotModel
from kilter_core.types import Ints

FULL_TILTING = ("clearance_tilt", "backlash_load", "axial_compliance")


@dataclass(frozen=True)
class IdentifyOptions:
    """Options of an identification, the names of the contract.

    ``level`` 1 joint offsets, 2 geometry, 3 geometry and non-geometric effects (3 when ``effects`` are given, else 2).
    ``effects`` ids, or documents with options and joints. ``free`` patterns replace the level's geometric parameters,
    ``fix`` patterns hold parameters (``alpha_*``). ``base`` and ``tool`` are "free" or "fixed"; with ``base`` "removed" only
    the distances between poses count (relative calibration). ``socket_distances_mm`` are known distances between ball
    sockets, {"1-2": 400.0}. ``tilt_first`` holds the
    effects while the geometry is identified (thesis 4.22, 5.20): those of the starting version, else those fitted first.
    ``search_mm`` and ``search_deg`` are half the box of a global search. ``intervals`` "bootstrap" or "profile" adds 95 %
    intervals that do not rest on the covariance. ``loss`` "huber"
    bounds what a wrong row pulls, "tukey" lets it go. ``noise_mm`` is the standard
    deviation of a coordinate when it is known; otherwise it is estimated. ``reference`` says in which frames a correction
    should put the tool where the nominal robot would be: "robot" (its own base and tool: the measurements were taken in
    them), "registration" (where the nominal robot fits the measurements best), or "auto": the robot's own for a frame
    that is fixed or that the registration finds within 10 mm and 1 degree of it. ``refit`` ("base",) gives every campaign
    and session a base of its own, ("tool",) a tool (a marker that was mounted anew), () one of each to all; None leaves
    the base to the device of the campaign. ``masses``
    "uncertain" carries the errors of masses and centres beside effects that follow the load, "as_stated" does not, "auto"
    does where none of them follows the sign of a load, and else lets the covariance hold what they do;
    ``mass_sigma_percent`` and ``com_sigma_mm`` are how well they are known, where it is not as the robot says. ``prior``
    "fleet" adds what versions of other robots of the type say before these rows (:mod:`kilter_core.identify.fleet`).
    """

    level: int | None = None
    method: str = "least_squares"
    tilt_first: bool = False
    effects: tuple[str | Mapping[str, Any], ...] = ()
    free: tuple[str, ...] = ()
    fix: tuple[str, ...] = ()
    base: str = "free"
    tool: str = "free"
    loss: str = "linear"
    noise_mm: float | None = None
    reference: str = "auto"
    seed: int = 0
    search_mm: float = 25.0
    search_deg: float = 10.0
    intervals: str | None = None
    socket_distances_mm: Mapping[str, float] = field(default_factory=dict)
    refit: tuple[str, ...] | None = None
    masses: str = "auto"
    mass_sigma_percent: float | None = None
    com_sigma_mm: float | None = None
    prior: str | None = None

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
        self._check_choice("level", (None, 1, 2, 3))
        self._check_method()
        self._check_choice("base", ("free", "fixed", "removed"))
        self._check_choice("tool", ("free", "fixed"))
        self._check_choice("loss", ("linear", "huber", "tukey"))
        self._check_choice("intervals", (None, "bootstrap", "profile"))
        self._check_choice("reference", ("auto", "robot", "registration"))
        self._check_masses()
        self._check_prior()
        if self.refit is not None and (set(self.refit) - {"base", "tool"} or len(set(self.refit)) < len(self.refit)):
            message = f'refit is {self.refit!r}: give ["base"], ["tool"], ["base", "tool"] or [].'
            raise OptionError(message, option="refit", value=self.refit)
        if self.noise_mm is not None and not self.noise_mm > 0:
            raise OptionError("noise_mm must be above 0: it is a standard deviation.", option="noise_mm")
        for name in ("search_mm", "search_deg"):
            if not getattr(self, name) > 0:
                raise OptionError(f"{name} must be above 0: it is half the width of the search.", option=name)
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
        """Refuse widths that are none, and those of masses that count as exact."""
        self._check_choice("masses", ("auto", "uncertain", "as_stated"))
        for name in ("mass_sigma_percent", "com_sigma_mm"):
            sigma = getattr(self, name)
            if sigma is not None and not sigma > 0:
                raise OptionError(f"{name} must be above 0: it is a standard deviation.", option=name)
            if sigma is not None and self.masses == "as_stated":
                raise OptionError(
                    f"{name} says how well masses are known, masses as_stated that they are exact: leave one of them out.",
                    option=name,
                )

    def _check_prior(self) -> None:
        """Refuse a prior beside a method that knows none, or that continues from a version's own."""
        self._check_choice("prior", (None, "fleet"))
        if self.prior is not None and (self.method != "least_squares" or self.tilt_first):
            other = "tilt_first, which holds effects" if self.method == "least_squares" else f"method {self.method}"
            raise OptionError(
                f"Prior fleet does not go with {other}: leave prior out, or take method least_squares without tilt_first.",
                option="prior",
            )

    def _check_method(self) -> None:
        """Refuse a method that there is not, and what does not go with the one there is."""
        self._check_choice("method", tuple(METHODS))
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

    def _check_choice(self, name: str, allowed: Sequence[Any]) -> None:
        value = getattr(self, name)
        if value not in allowed:
            offered = ", ".join(str(a) for a in allowed if a is not None)
            raise OptionError(f"{name} is {value!r}: give {offered}.", option=name, value=value)


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
