"""Errors of the measurement and of its time: scale, clock, servo lag, and a tilt that an inclinometer reads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import BASE, Derivative, Effect, Local, frame_twists, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import DELAY, INSTRUMENT, READ_STATION
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class MeasurementScale(Effect):
    """The measured position is (1 + s) times the real one, seen from the origin of the measurements."""

    id = "measurement_scale"
    summary = "scale error of the instrument"
    physical = INSTRUMENT
    source = "measurement scale: absorbed exactly by the link lengths"
    stage = "measurement"
    aliases = ("thermal_growth", "encoder_scale")
    remedy = "measure an artefact of known length: from robot data it cannot be distinguished from the link lengths"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Relative scale error s."""
        return (Parameter("measurement_scale", "1", 0.0, 1e-3, -0.02, 0.02, "relative scale error of the instrument"),)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Stretch and its derivative by s."""
        return linear(batch, values, [Derivative(0, scale=np.ones(len(batch)))])


@dataclass(frozen=True)
class TimeOffset(Effect):
    """dq = q̇ dt for all joints: the position was taken dt after the joint readings of its row."""

    id = "time_offset"
    summary = "delay between the joint readings and the measured positions"
    physical = DELAY
    source = "time offset of controller and tracker; first order in dt"
    needs = frozenset({"qd"})
    stage = "measurement"
    aliases = ("tracking_lag", "drift")
    remedy = "record moving arms at different speed profiles: at rest, or at one speed, it cannot be seen"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Delay dt, s."""
        return (
            Parameter("time_offset", "s", 0.0, 0.02, -0.5, 0.5, "delay of the positions behind the joint readings"),
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint corrections and their derivative by dt."""
        speed = self.column(batch, "qd")
        return linear(batch, values, [Derivative(0, j, dq=speed[:, j]) for j in range(batch.q.shape[1])])


@dataclass(frozen=True)
class TrackingLag(Effect):
    """dq = −τ q̇ per joint, τ >= 0: the joint is where its setpoint was τ ago. For rows whose q are setpoints."""

    id = "tracking_lag"
    summary = "servo lag of a joint behind its setpoint"
    physical = DELAY
    source = "Slamani, Nubiola and Bonev 2012, contouring errors against speed"
    needs = frozenset({"qd"})
    signs = "positive"
    aliases = ("time_offset",)
    remedy = "record moving arms and read back the actual joint angles: equal lags of all joints are a time offset"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Lag τ per joint, s."""
        return self.per_joint(robot, "lag", "s", 0.02, 0.0, 0.5, "lag behind the setpoint")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by τ."""
        return self.joint_angle(batch, values, -self.column(batch, "qd"))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the lag of each joint."""
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            form.curve(j, Shape.LAG, value)
        return True


@dataclass(frozen=True)
class MeasuredTilt(Effect):
    """The base frame moves with the reading t = (tx, ty) of an inclinometer about its x and y, less that at its zero.

    It rotates by (gx tx + cx ty, gy ty + cy tx, 0) and shifts by t × l: l leads from the point that stays, where a column
    is bolted down, to the origin of the base frame. g is 1 for a stiff column whose sensor is in the axes of the base
    frame, c 0; a sensor in other axes, or a column that bends above it, has others. What the reading leaves out (a shift
    without a tilt, a rotation about the vertical) it cannot tell.
    """

    id = "measured_tilt"
    summary = "base moves as its inclinometer reads"
    physical = READ_STATION
    source = (
        "rigid motion of a column about where it is bolted down, to first order in the tilt that its inclinometer reads"
    )
    needs = frozenset({"base_tilt_x", "base_tilt_y"})
    stage = "base"
    aliases = ("base_compliance", "drift", "column_bending")
    remedy = "read a two-axis inclinometer on the base or column in every pose"
    at_joints = False

    zero_x_rad: float | None = option(
        None, "Reading about x at which the geometry holds, rad; null: the mean of the rows."
    )
    zero_y_rad: float | None = option(
        None, "Reading about y at which the geometry holds, rad; null: the mean of the rows."
    )

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Let the geometry hold at the mean reading of the rows."""
        if rows is None or rows.base_tilt_x is None or rows.base_tilt_y is None or not len(rows):
            return self
        x = float(np.mean(rows.base_tilt_x)) if self.zero_x_rad is None else self.zero_x_rad
        y = float(np.mean(rows.base_tilt_y)) if self.zero_y_rad is None else self.zero_y_rad
        return replace(self, zero_x_rad=x, zero_y_rad=y)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Gains about x and y, cross gains, 1; then the lever, m."""
        about = "rotation of the base about its {} per reading about {}"
        gains = [Parameter(f"tilt_gain_{k}", "1", 0.0, 1.0, -5.0, 5.0, about.format(k, k)) for k in "xy"]
        cross = [
            Parameter(f"tilt_cross_{k}", "1", 0.0, 0.3, -3.0, 3.0, about.format(k, other)) for k, other in ("xy", "yx")
        ]
        text = "from the point that stays to the base, along its "
        return (*gains, *cross, *(Parameter(f"tilt_lever_{k}", "m", 0.0, 1.0, -20.0, 20.0, text + k) for k in "xyz"))

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives."""
        x, y = (np.asarray(self.column(batch, f"base_tilt_{k}"), dtype=np.float64) for k in "xy")
        moved = _base_twists(x - _zero(self.zero_x_rad), y - _zero(self.zero_y_rad))
        return frame_twists(batch, values, BASE, moved)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Move the base by the tilt of now, where one is stated."""
        tilt = form.conditions.base_tilt
        if tilt is None:
            return False
        x, y = (np.array([t - _zero(zero)]) for t, zero in zip(tilt, (self.zero_x_rad, self.zero_y_rad), strict=True))
        twist = values @ _base_twists(x, y)[:, 0]
        form.base_shift += twist[:3]
        form.base_tilt += twist[3:]
        return True


def _zero(reading: float | None) -> float:
    if reading is None:
        raise OptionError(
            "measured_tilt needs zero_x_rad and zero_y_rad: give the readings at which the geometry holds."
        )
    return reading


def _base_twists(x: Floats, y: Floats) -> Floats:
    """Twists (7, N, 6) of the base per parameter at readings (N,) less their zeros."""
    out = np.zeros((7, len(x), 6))
    out[0, :, 3] = out[3, :, 4] = x
    out[1, :, 4] = out[2, :, 3] = y
    out[4, :, 2], out[5, :, 2] = -y, x  # (x, y, 0) × l
    out[6, :, 0], out[6, :, 1] = y, -x
    return out
