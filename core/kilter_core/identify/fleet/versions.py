"""Versions of other arms, and whether they are of one type and in one gauge: only then do their parameters mean the same."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.model import Calibration, RobotModel
from kilter_core.types import Floats

FRAMES = ("base_", "tool_")


@dataclass(frozen=True)
class Gauge:
    """What must agree for parameters to mean the same: the ``effects`` that were fitted, the ``frames`` that could take up
    what the chain has, the ``free`` parameters of chain and effects, and their ``units``.
    """

    effects: tuple[str, ...]
    frames: tuple[str, ...]
    free: frozenset[str]
    units: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def from_model(model: RobotModel, free: Sequence[str]) -> Gauge:
        """Gauge of a fit of these parameters of a model; what only the measurement or the load has is left out."""
        own = set(of_the_type(model))
        effects = tuple(sorted(repr(e.to_document()) for e in model.effects if _of_the_arm(e)))
        frames = tuple(frame for frame in FRAMES if any(name.startswith(frame) for name in free))
        units = {p.name: p.unit for p in model.parameters if p.name in own}
        return Gauge(effects, frames, frozenset(own & set(free)), units)

    def differs(self, other: Gauge) -> str | None:
        """In which way another gauge differs from this one, in words; None where it does not."""
        if self.effects != other.effects:
            return "other effects were fitted, or with other options"
        for frame in FRAMES:
            if (frame in self.frames) != (frame in other.frames):
                there, here = ("fitted", "held") if frame in other.frames else ("held", "fitted")
                return f"the {frame[:-1]} was {there} there and is {here} here"
        for name in sorted(self.free & other.free):
            if self.units[name] != other.units[name]:
                return f"{name} is in {other.units[name]} there and in {self.units[name]} here"
        more, fewer = sorted(other.free - self.free), sorted(self.free - other.free)
        if more or fewer:
            said = [f"{_format_names(more)} {'was' if len(more) == 1 else 'were'} fitted there alone"] if more else []
            said += [f"{_format_names(fewer)} {'was' if len(fewer) == 1 else 'were'} not fitted there"] if fewer else []
            return ", ".join(said)
        return None


@dataclass(frozen=True)
class FleetVersion:
    """A version of another arm: ``values (K,)`` and ``covariance (K, K)`` SI of the parameters ``names`` it was fitted for."""

    robot: str
    version: str
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    gauge: Gauge

    @staticmethod
    def from_calibration(
        robot: str, version: str, calibration: Calibration, covariance: Mapping[str, Any]
    ) -> FleetVersion:
        """The version ``version`` of a ``robot`` from its calibration and the covariance that is stored with it."""
        names = tuple(covariance.get("names") or ())
        value = dict(zip(calibration.names, calibration.values, strict=True))
        matrix = np.array(covariance.get("matrix") or np.zeros((0, 0)), dtype=np.float64)
        values = np.array([float(value.get(name, 0.0)) for name in names])
        return FleetVersion(robot, version, names, values, matrix, Gauge.from_model(calibration.model, names))


def same_type(robot: Robot, other: Robot) -> bool:
    """Whether two robots are nominally one arm: the same joints on the same chain; base, tool and limits are their own."""
    return bool(
        [joint.kind for joint in robot.joints] == [joint.kind for joint in other.joints]
        and list(_chain(robot)) == list(_chain(other))
    )


def of_the_type(model: RobotModel) -> list[str]:
    """Parameters of a model that arms of a type share: where an arm stands and what it carries are its own."""
    names = list(model.names[6 : model.n_geometric - 6])
    for effect, where in model.effects_with_slices:
        names += model.names[where] if _of_the_arm(effect) else ()
    return names


def _of_the_arm(effect: Any) -> bool:
    return effect.stage != "measurement" and not effect.nuisance


def _chain(robot: Robot) -> Iterator[tuple[Any, ...]]:
    for e in robot.chain.elements:
        yield e.axis, e.joint, e.name, e.ratio, round(float(e.value), 9)


def _format_names(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
