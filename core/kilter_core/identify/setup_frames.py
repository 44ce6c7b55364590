"""Set-ups that each have a frame of their own: a sheet of paper is laid anew for every drawing, a marker mounted anew.

Rows of several set-ups share the arm and not the base, or not the tool. Every set-up after the first gets increments of
the base or the tool beside the arm's parameters, so that where a sheet lay, or a marker sat, can neither pass for an error
of the arm nor hide one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from kilter_core.arm.chain import frame_parameters, increment
from kilter_core.arm.robot import Robot
from kilter_core.effects import BASE, TOOL, Batch, Effect, Local
from kilter_core.effects.base import Derivative, linear
from kilter_core.errors import OptionError, TooFewPosesError
from kilter_core.identify.estimate import bounded_loss, frames_alone
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.options import FRAME_NAMES, IdentifyOptions
from kilter_core.identify.views import Cameras, rig_from_calibration
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts
from kilter_core.measurement.frames import register
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter, degrees, mm
from kilter_core.transforms import inverse, rotation_log
from kilter_core.types import Bools, Floats

FEWEST_POSES = 4  # three fit any triangle: nothing would be left to see an error by
ROUNDS = 3  # of registering base and tool in turn, for the start


@dataclass(frozen=True)
class _OfSetups(Effect):
    """Increments of a frame in each of the ``codes`` after the first, of the measurement: never part of a version."""

    stage = "measurement"
    at_joints = False
    frame: ClassVar[int]
    stem: ClassVar[str]

    codes: tuple[int, ...] = ()

    @property
    def each(self) -> int:
        """How many numbers a set-up has."""
        return 6

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Numbers of each later set-up, m and rad, as wide as those of the frame itself."""
        return tuple(p for code in self.codes[1:] for p in frame_parameters(f"{self.stem}_{code}")[: self.each])

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the frame; rows without a set-up are of the first."""
        if batch.setup is None:
            return Local()
        columns = [axis * (batch.setup == code)[:, None] for code in self.codes[1:] for axis in np.eye(6)[: self.each]]
        return linear(batch, values, [Derivative(k, self.frame, xi=xi) for k, xi in enumerate(columns)])


@dataclass(frozen=True)
class SetupFrames(_OfSetups):
    """Bases of set-ups."""

    id = "setup_frames"
    summary = "base frame of every set-up of the instrument"
    source = "an instrument, or a sheet, that was set up anew"
    frame = BASE
    stem = "setup"


@dataclass(frozen=True)
class SetupTools(_OfSetups):
    """Tools of set-ups, which rotate against one another only with ``turns``."""

    id = "setup_tools"
    summary = "tool of every set-up"
    source = "a marker or a reflector that was mounted anew"
    frame = TOOL
    stem = "setup_tool"

    turns: bool = False

    @property
    def each(self) -> int:
        """How many numbers a set-up has: three without rotation."""
        return 6 if self.turns else 3


OF_SETUPS = (SetupFrames, SetupTools, Cameras)  # effects that say how it was measured, and not how the arm is


@dataclass(frozen=True)
class OwnFrame:
    """A set-up whose base or tool was fitted to its own rows, and how far (m, rad) it is from that of the version."""

    code: int
    use: str
    moved: float
    turned: float
    which: str = "base"

    def to_document(self) -> dict[str, Any]:
        """JSON-able, mm and degrees."""
        moved, turned = mm(self.moved), float(degrees(self.turned))
        return {"setup": self.code, "use": self.use, "moved_mm": moved, "turned_deg": turned}


@dataclass(frozen=True)
class Frames:
    """The set-ups of the training rows: ``lays`` (4, 4) take what each measured into the frame of the first.

    ``own`` names what each has of its own, base or tool; the tools rotate where ``turns``.
    """

    lays: Mapping[int, Floats]
    own: tuple[str, ...] = ("base",)
    turns: bool = False

    @staticmethod
    def from_observations(begin: Calibration, train: Observations, options: IdentifyOptions) -> Frames | None:
        """Find where each set-up lies by the model to begin with; None where all rows are given in one frame.

        Raises:
            OptionError: a method that cannot fit several frames. TooFewPosesError: a set-up with too few poses.

        """
        own = tuple(which for which in options.refit or ("base",) if getattr(options, which) != "fixed")
        placed = train.position is not None or train.markers is not None
        if train.setup is None or not own or has_contacts(train) or not placed:
            return None
        codes = [int(code) for code in np.unique(train.setup[train.tool_seen])]
        if len(codes) > 1:
            _refuse(train, codes, options)
        if options.base == "removed":
            return None
        lays = _lays(begin, train, codes) if "base" in own else [np.eye(4)] * len(codes)
        turns = train.rotation is not None or train.markers is not None
        return Frames(dict(zip(codes, lays, strict=True)), own, turns)

    def laid(self, rows: Observations) -> Observations:
        """Rows of these set-ups, given in the frame of the first; others as they are."""
        for code, T in self.lays.items():
            if rows.setup is not None and np.any(rows.setup == code):
                rows = _transform_rows(rows, T, rows.setup == code)
        return rows

    def in_model(self, begin: Calibration) -> Calibration:
        """The model to fit, with the frames of the later set-ups."""
        if len(self.lays) < 2:
            return begin
        codes = tuple(self.lays)
        made = {"base": SetupFrames(codes=codes), "tool": SetupTools(codes=codes, turns=self.turns)}
        return begin.with_effects([*begin.model.effects, *(made[which] for which in self.own)])

    def fitted_frames(self, calibration: Calibration) -> list[OwnFrame]:
        """Frames that a fit of several training set-ups found."""
        values = dict(zip(calibration.names, calibration.values, strict=True))
        return [*(self._bases(calibration, values) if "base" in self.own else ()), *self._tools(values)]

    def _tools(self, values: Mapping[str, float]) -> list[OwnFrame]:
        """Tools of the later set-ups, none where they share one."""
        out = []
        for code in list(self.lays)[1:] if "tool" in self.own else ():
            twist = np.array([values.get(f"setup_tool_{code}_{name}", 0.0) for name in FRAME_NAMES])
            sizes = (float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:])))
            out.append(OwnFrame(code, "train", *sizes, "tool"))
        return out

    def _bases(self, calibration: Calibration, values: Mapping[str, float]) -> list[OwnFrame]:
        """Bases of the later set-ups."""
        out = []
        T = calibration.model.absorb_frame_increments(calibration.values)[0].T_base
        for code, lay in list(self.lays.items())[1:]:
            six = np.array([values[f"setup_{code}_{name}"] for name in FRAME_NAMES])
            out.append(frame_shift(code, "train", T, inverse(lay) @ T @ increment(six)))
        return out


def _refuse(train: Observations, codes: list[int], options: IdentifyOptions) -> None:
    assert train.setup is not None
    if options.method != "least_squares" or options.tilt_first or options.base == "removed":
        raise OptionError(
            f"{len(codes)} set-ups with a frame each are identified by method least_squares, without tilt_first, with a "
            'free base. Take that, or say with "refit": [] that all of them share one frame.',
            option="refit",
        )
    groups = train.pose_groups()
    for code in codes:
        poses = len(np.unique(groups[train.setup == code]))
        if poses < FEWEST_POSES:
            raise TooFewPosesError(
                f"A set-up with a frame of its own has {poses} poses, {FEWEST_POSES} are needed to find the frame. "
                'Measure more there, or say with "refit": [] that all set-ups share one frame.',
                poses=poses,
                needed=FEWEST_POSES,
            )


def _lays(begin: Calibration, train: Observations, codes: list[int]) -> list[Floats]:
    """What takes each set-up into the frame of the first, by registering bases and the tool in turn."""
    model, values = begin.model.absorb_frame_increments(begin.values)
    shape = Measurement.from_observations(train, begin.marker_points).marker_points
    assert train.setup is not None
    lays = [np.eye(4) for _ in codes]
    for _ in range(ROUNDS if len(codes) > 1 else 0):
        bases = []
        for code in codes:
            rows = Measurement.from_observations(train.select(train.setup == code), shape)
            bases.append(register(model, values, rows, tool=False)[0])
        lays = [bases[0] @ inverse(T) for T in bases]
        together = Measurement.from_observations(Frames(dict(zip(codes, lays, strict=True))).laid(train), shape)
        model = model.in_frames(model.T_base, register(model, values, together)[1])
    return lays


def _transform_rows(rows: Observations, T: Floats, which: Bools) -> Observations:
    """Rows with what was measured in ``which`` of them moved by the pose T (4, 4)."""
    R, p = T[:3, :3], T[:3, 3]
    changes: dict[str, Any] = {}
    for name in ("position", "markers"):
        value = getattr(rows, name)
        if value is not None:
            changes[name] = value.copy()
            changes[name][which] = value[which] @ R.T + p
    if rows.rotation is not None:
        changes["rotation"] = rows.rotation.copy()
        changes["rotation"][which] = R @ rows.rotation[which]
    if rows.pose_weight is not None:
        changes["pose_weight"] = rows.pose_weight.copy()
        changes["pose_weight"][which] = rows.pose_weight[which] @ np.kron(np.eye(2), R.T)
    if rows.sigma is not None:
        changes["sigma"] = rows.sigma.copy()
        changes["sigma"][which] = np.sqrt(rows.sigma[which] ** 2 @ (R**2).T)
    if rows.tip is not None:
        changes["tip"] = rows.tip.copy()
        changes["tip"][which] = rows.tip[which] @ R.T + p
    return replace(rows, **changes)


def without_frames(calibration: Calibration) -> Calibration:
    """The calibration of the arm alone, in the frame of the first set-up; cameras stand beside it as they were found."""
    effects = [effect for effect in calibration.model.effects if not isinstance(effect, OF_SETUPS)]
    if len(effects) == len(calibration.model.effects):
        return calibration
    return replace(calibration.with_effects(effects), rig=rig_from_calibration(calibration))


def of_the_arm(fit: Fit) -> Bools:
    """Which of a fit's free parameters (F,) are not frames of later set-ups, nor of cameras and boards."""
    frames = {
        p.name
        for e in fit.problem.model.effects
        if isinstance(e, OF_SETUPS)
        for p in e.parameters(fit.problem.model.robot)
    }
    return np.array([name not in frames for name in fit.names])


def marginal(fit: Fit) -> Fit:
    """The fit as the arm's parameters see it: the frames of later set-ups are taken out of Jacobian and covariance."""
    arm = of_the_arm(fit)
    if arm.all():
        return fit
    own, frames = fit.J[:, arm], fit.J[:, ~arm]
    Q = np.linalg.qr(frames)[0]
    problem = replace(fit.problem, free=fit.problem.free[arm], held=None, anchor=None)
    return replace(fit, problem=problem, J=own - Q @ (Q.T @ own), covariance=fit.covariance[np.ix_(arm, arm)])


def split_by_setup(frames: Frames | None, rows: Observations) -> list[tuple[int | None, Bools]]:
    """Which rows (N,) are of the set-ups that were fitted (None), and which of each other one."""
    if frames is None or rows.setup is None:
        return [(None, np.ones(len(rows), bool))]
    new = [int(code) for code in np.unique(rows.setup) if int(code) not in frames.lays]
    found = [(None, ~np.isin(rows.setup, new)), *((code, np.asarray(rows.setup == code)) for code in new)]
    return [one for one in found if one[1].any()]


def with_own_frames(
    calibration: Calibration, measurement: Measurement, loss: str, which: Sequence[str] = ("base",)
) -> Calibration:
    """The calibration with its base, its tool or both fitted to other rows, all else held."""
    alone = without_frames(calibration)
    model, values = alone.model.absorb_frame_increments(alone.values)
    n = model.n_geometric
    held = {"base": model.names[:6], "tool": model.names[n - 6 : n]}
    fixed = [name for frame, names in held.items() if frame not in which for name in names]
    base, tool = ("free" if frame in which else "fixed" for frame in held)
    fix = (*model.names[6 : n - 6], *model.names[n:], *fixed)
    options = IdentifyOptions(fix=fix, base=base, tool=tool, loss=bounded_loss(loss))
    return frames_alone(Calibration(model, values, measurement.marker_points), measurement, options)


def frame_shift(code: int, use: str, before: Floats, after: Floats, which: str = "base") -> OwnFrame:
    """How far a frame (4, 4) of a set-up is from that of the version."""
    between = inverse(before) @ after
    turned = float(np.linalg.norm(rotation_log(between[None, :3, :3])))
    return OwnFrame(code, use, float(np.linalg.norm(between[:3, 3])), turned, which)
