"""A calibration: a model with values, where cameras, boards and frames stand, and where it is less sure than it says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.load_wrenches import LoadChain
from kilter_core.arm.robot import Robot
from kilter_core.effects import Effect, effect_from_document
from kilter_core.effects.laws import carried_effects
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.model.prediction import Prediction
from kilter_core.model.robot_model import RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import indices
from kilter_core.types import Bools, Floats


@dataclass(frozen=True)
class Doubt:
    """A box of joint values ``low (n,)`` to ``high (n,)``, rad or m, infinite where a joint bounds it not.

    ``error_m`` is the length by which the tool may be off there beyond what the version says; ``reason`` says why.
    """

    low: Floats
    high: Floats
    error_m: float
    reason: str

    @staticmethod
    def everywhere(n: int, error_m: float, reason: str) -> Doubt:
        """Return the doubt about a whole version."""
        return Doubt(np.full(n, -np.inf), np.full(n, np.inf), error_m, reason)

    @property
    def whole(self) -> bool:
        """Whether it is about every pose."""
        return not np.isfinite([self.low, self.high]).any()

    def holds(self, q: Floats) -> Bools:
        """Which joint vectors (N, n) are in the box."""
        return np.asarray(((q >= self.low) & (q <= self.high)).all(axis=1))

    def to_document(self) -> dict[str, Any]:
        """JSON-able, SI; None where a joint bounds the box not."""
        ends = {name: [v if np.isfinite(v) else None for v in getattr(self, name).tolist()] for name in ("low", "high")}
        return {**ends, "error_m": self.error_m, "reason": self.reason}

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Doubt:
        """Rebuild from :meth:`to_document`."""
        low, high = (
            np.array([open_end if v is None else v for v in document[name]], dtype=np.float64)
            for name, open_end in (("low", -np.inf), ("high", np.inf))
        )
        return Doubt(low, high, float(document["error_m"]), str(document["reason"]))


def unexplained_error(doubts: Sequence[Doubt], q: Floats) -> Floats:
    """Return the largest unexplained error (N,) m of the doubts that hold each joint vector (N, n); 0 where none does."""
    out = np.zeros(len(q))
    for doubt in doubts:
        out = np.maximum(out, np.where(doubt.holds(q), doubt.error_m, 0.0))
    return out


ARRAYS = ("marker_points", "wanted_base", "wanted_tool")  # of a calibration, beside its values


@dataclass(frozen=True)
class Calibration:
    """A model with values: what a parameter version holds. ``marker_points (m, 3)`` m are in the tool frame.

    ``wanted_base`` and ``wanted_tool`` (4, 4) are the frames in which the nominal chain says where the tool should be:
    the robot's own where the measurements were taken in them, else those of the registration. The difference to the
    identified frames is part of the arm's error, because base and first joint, tool and last joint share what they share.
    ``rig`` has the cameras and boards where they were found to stand. ``doubts`` say where it is less sure than it says.
    """

    model: RobotModel
    values: Floats
    marker_points: Floats | None = None
    wanted_base: Floats | None = None
    wanted_tool: Floats | None = None
    rig: PlacedRig | None = None
    doubts: tuple[Doubt, ...] = ()

    @staticmethod
    def nominal(robot: Robot, effects: tuple[Effect, ...] = ()) -> Calibration:
        """The nominal robot."""
        model = RobotModel(robot, effects)
        return Calibration(model, model.values0())

    @property
    def robot(self) -> Robot:
        """The nominal robot."""
        return self.model.robot

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.model.names

    def predict(self, observations: Observations) -> Prediction:
        """Tool poses of the rows."""
        return self.model.predict(observations, self.values).with_rig(self.rig)

    def with_effects(self, effects: Sequence[Effect]) -> Calibration:
        """The same values with another list of effects; parameters of new effects start at their prior mean."""
        model = replace(self.model, effects=tuple(effects))
        known = dict(zip(self.names, self.values, strict=True))
        values = np.array([known.get(p.name, p.value) for p in model.parameters])
        return replace(self, model=model, values=values)

    def for_another_campaign(self, rows: Observations) -> Calibration:
        """The same for rows that it was not made from: laws of time count only where one clock says when they were measured."""
        return self.with_effects(carried_effects(self.model.effects, rows))

    def unknown_sides(self, rows: Observations) -> Bools:
        """Which rows (N,) say too little: the model follows from which side a joint came, and their order does not tell it."""
        unknown = np.zeros(len(rows), dtype=bool)
        if rows.directions_derived and rows.direction is not None:
            for effect in self.model.effects:
                if "direction" in effect.needs:
                    unknown |= (rows.direction[:, effect.acting(rows.q.shape[1])] == 0.0).any(axis=1)
        return unknown

    def with_robot(self, robot: Robot) -> Calibration:
        """The same values, of the robot with other knowledge of its masses."""
        return replace(self, model=replace(self.model, robot=robot))

    def nominal_in_wanted_frames(self) -> Calibration:
        """The nominal chain in the wanted frames: where the tool should be."""
        base = self.robot.T_base if self.wanted_base is None else self.wanted_base
        tool = self.robot.T_tool if self.wanted_tool is None else self.wanted_tool
        model = RobotModel(self.robot, (), base, tool)
        return Calibration(model, model.values0(), wanted_base=self.wanted_base, wanted_tool=self.wanted_tool)

    def to_document(self) -> dict[str, Any]:
        """JSON-able state, SI: frames, effects, and every parameter's value by name."""
        model, values = self.model.absorb_frame_increments(self.values)
        return {
            "T_base": model.T_base.tolist(),
            "T_tool": model.T_tool.tolist(),
            "effects": [effect.to_document() for effect in model.effects],
            "values": dict(zip(model.names, values.tolist(), strict=True)),
            **{k: None if (array := getattr(self, k)) is None else array.tolist() for k in ARRAYS},
            "load_chain": None if model.load_chain is None else model.load_chain.to_document(model.robot),
            "rig": None if self.rig is None else self.rig.to_document(),
            **({"doubts": [doubt.to_document() for doubt in self.doubts]} if self.doubts else {}),
        }

    @staticmethod
    def from_document(robot: Robot, document: Mapping[str, Any]) -> Calibration:
        """Rebuild from :meth:`to_document` for the same robot; names the robot does not have raise ``OptionError``."""
        effects = tuple(effect_from_document(e).as_stored(robot, e) for e in document["effects"])
        frames = np.array(document["T_base"]), np.array(document["T_tool"])
        model = RobotModel(robot, effects, *frames, LoadChain.from_document(robot, document.get("load_chain")))
        values = model.values0()
        stored = document["values"]
        values[indices(model.names, stored)] = list(stored.values())
        arrays: dict[str, Any] = {k: np.array(document[k]) for k in ARRAYS if document.get(k) is not None}
        doubts = tuple(map(Doubt.from_document, document.get("doubts") or ()))
        return Calibration(model, values, **arrays, rig=PlacedRig.from_document(document.get("rig")), doubts=doubts)
