"""What moves with temperature: base, instrument, column, links and joint zeros."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import BASE, Derivative, Local, frame_rates, frame_twists, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.laws import LawOfTemperature
from kilter_core.effects.physical import JOINT_ZERO, THERMAL, Separator
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ThermalDrift(LawOfTemperature):
    """The base frame moves with temperature: a twist of six rates times T − T0, in its own axes.

    ``reference_c`` is T0, at which the geometry holds. Whatever rotates a vertical first joint with temperature does the
    same to every measurement, and so does a bending column: where one of them fits, this belongs to its class.
    """

    id = "thermal_drift"
    summary = "motion of the base or of the instrument with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE, Separator.SENSOR)
    source = "ISO 230-3, environmental temperature variation"
    stage = "base"
    aliases = ("zero_thermal", "column_bending", "thermal_growth", "scale_thermal", "drift")
    remedy = "measure a reflector on the base cold and warm beside the poses"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rates along x, y, z, m/K, then about them, rad/K."""
        return frame_rates("thermal_drift", "K", 1e-5, 2e-4)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the rates."""
        warmer = self.warmer(batch)
        moved = np.eye(6)[:, None, :] * warmer[:, None]
        return frame_twists(batch, values, BASE, moved)


@dataclass(frozen=True)
class ThermalGrowth(LawOfTemperature):
    """Every link, and the column up to the first joint, grows by α (T − T0) of its length; the tool does not.

    ``reference_c`` is T0, at which the geometry holds. Any T0 will do as long as all campaigns use the same one.
    """

    id = "thermal_growth"
    summary = "links grow with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE,)
    source = "Yin et al. 2014, warm-up of robot joints; linear expansion of steel and aluminium"
    signs = "positive"
    aliases = ("drift", "measurement_scale")
    remedy = "revisit the same poses cold and warm, with a temperature in every row"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Coefficient of expansion α, 1/K; steel has 12e-6, aluminium 23e-6.

        The range is wider than that of metals: the thermometer is seldom where the links are warmest.
        """
        return (Parameter("expansion", "1/K", 0.0, 2e-5, 0.0, 1e-4, "coefficient of expansion"),)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of each joint's frame along its link, of the base frame along the column; and the derivative."""
        warmer = self.warmer(batch)
        grown = np.zeros((len(batch.link_vectors), len(batch), 6))
        grown[:, :, :3] = batch.link_vectors[:, None, :] * warmer[:, None]
        places = [*range(len(grown) - 1), BASE]
        return linear(batch, values, [Derivative(0, place, xi=xi) for place, xi in zip(places, grown, strict=True)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the growth of every link at the temperature of now."""
        warmer = self.warmer_now(form)
        if warmer is None:
            return False
        grown = float(values[0]) * warmer * form.robot.chain.link_vectors
        for j, translation in enumerate(grown[:-1]):
            form.twist(j, translation)
        form.base_shift += grown[-1]
        return True


@dataclass(frozen=True)
class LinkGrowth(LawOfTemperature):
    """The link after joint i grows by α (T − T0) of its length, the others do not; ``reference_c`` is T0.

    All links together are ``thermal_growth``, which also takes the column under the first joint with it.
    """

    id = "link_growth"
    summary = "one link grows with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE,)
    source = "linear expansion; Yin et al. 2014: links beside motors warm up alone"
    signs = "positive"
    aliases = ("thermal_growth", "zero_thermal", "drift")
    remedy = "revisit the same poses cold and warm, with the link stretched out and folded back"

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on the links that have a length."""
        return self.restrict_to_long_links(robot)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Coefficient of expansion α per link, 1/K; steel has 12e-6, aluminium 23e-6."""
        text = "coefficient of expansion of the link after this joint"
        return self.per_joint(robot, "link_expansion", "1/K", 2e-5, 0.0, 1e-4, text)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of each joint's frame along its link, and the derivative."""
        return self.along_links(batch, values, self.warmer(batch))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the growth of each link at the temperature of now."""
        warmer = self.warmer_now(form)
        if warmer is None:
            return False
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            form.twist(j, value * warmer * form.robot.chain.link_vectors[j])
        return True


@dataclass(frozen=True)
class ZeroThermal(LawOfTemperature):
    """dq = k (T − T0) per joint; ``reference_c`` is T0, at which the geometry holds."""

    id = "zero_thermal"
    summary = "zero of a joint moves with temperature"
    physical = JOINT_ZERO
    separated_by = (Separator.TEMPERATURE,)
    source = "Yin et al. 2014, warm-up of robot joints: the zeros move first"
    aliases = ("thermal_drift", "zero_drift", "column_bending", "thermal_growth", "link_growth")
    remedy = "revisit the same poses cold and warm, with a temperature in every row"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rate k per joint, rad/K."""
        return self.per_joint(robot, "zero_thermal", "rad/K", 2e-5, -5e-4, 5e-4, "zero of the joint by temperature")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by k."""
        warmer = self.warmer(batch)
        return self.joint_angle(batch, values, np.broadcast_to(warmer[:, None], batch.q.shape))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the shift of each zero at the temperature of now."""
        warmer = self.warmer_now(form)
        if warmer is None:
            return False
        form.add("offset", self.acting(len(form.joints)), values * warmer)
        return True


@dataclass(frozen=True)
class ScaleThermal(LawOfTemperature):
    """The measured position is 1 + k (T − T0) times the real one, seen from the origin of the measurements.

    A growth of all links by k beside a drift of the base by k times its position does exactly the same but at the tool.
    """

    id = "scale_thermal"
    summary = "scale of the instrument changes with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE, Separator.SENSOR)
    source = "Ciddor 1996, refractive index of air: 1e-6 a kelvin; expansion of a scale bar, 23e-6 of aluminium"
    stage = "measurement"
    aliases = ("thermal_drift", "thermal_growth", "link_growth")
    remedy = "measure a reflector on the base, or an artefact of known length, cold and warm beside the poses"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rate k of the scale, 1/K."""
        return (Parameter("scale_thermal", "1/K", 0.0, 1e-5, -1e-4, 1e-4, "rate of the instrument's scale"),)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Stretch and its derivative by k."""
        return linear(batch, values, [Derivative(0, scale=self.warmer(batch))])


@dataclass(frozen=True)
class ColumnBending(LawOfTemperature):
    """The base frame rotates by (kx, ky, 0) (T − T0) about its origin; ``reference_c`` is T0, at which the geometry holds."""

    id = "column_bending"
    summary = "column under the arm bends with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE,)
    source = "ISO 230-3, environmental temperature variation: a gradient across a column bends it"
    stage = "base"
    aliases = ("thermal_drift", "zero_thermal", "thermal_growth", "drift", "settling")
    remedy = "measure a reflector on the base cold and warm, or revisit the same poses all around cold and warm"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rates kx, ky about x and y of the base frame, rad/K."""
        return tuple(
            Parameter(f"column_bending_{k}", "rad/K", 0.0, 1e-5, -2e-4, 2e-4, f"rotation of the base about its {k}")
            for k in "xy"
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives."""
        warmer = self.warmer(batch)
        turns = np.zeros((2, len(batch), 6))
        turns[0, :, 3] = turns[1, :, 4] = warmer
        return frame_twists(batch, values, BASE, turns)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the tilt of the base at the temperature of now."""
        warmer = self.warmer_now(form)
        if warmer is None:
            return False
        form.base_tilt[:2] += values * warmer
        return True
