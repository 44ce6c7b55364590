"""Soft start of a strain wave gear: below a knee of the load its compliance is larger than above."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from kilter_core.arm.loads.wrenches import axial_loads, row_load_wrenches
from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, Local, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_TWIST, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

KNEES = (0.1, 0.2)  # that are tried, of the largest load on the joint: a larger one is as good as hardening
LEAST_LOAD_NM = 1e-3


@dataclass(frozen=True)
class StrainWave(Effect):
    """dq = b tanh(ηz/``knee_nm``) with b >= 0, beside the c ηz of ``axial_compliance``, the gear's stiffness at large loads.

    A maker states a stiffness K1 up to a torque T1, K2 up to T2 and K3 beyond; b is near T1 (1/K1 − 1/K3), and the knee
    lies between T1 and T2.
    """

    id = "strain_wave"
    summary = "gear softer at small loads than at large ones: a strain wave gear"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "Harmonic Drive: stiffness K1 < K2 < K3 by load; Tuttle 1992, harmonic drives"
    needs = frozenset({"moments"})
    reads = (("axial", (0,)),)
    signs = "positive"
    aliases = ("hardening", "backlash_load", "axial_compliance")
    remedy = "repeat poses with three payloads or more, one of them none"
    rarer = float(len(KNEES))  # it has one of so many knees

    knee_nm: float = option(10.0, "Load at which the soft start ends, N m, above 0.", above=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.knee_nm > 0.0:
            raise OptionError(f"strain_wave has knee_nm {self.knee_nm!r}: give N m above 0.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Two knees at each revolute joint, within the loads that it bears in these rows."""
        largest = np.max(np.abs(axial_loads(robot, row_load_wrenches(robot, rows))), axis=0, initial=0.0)
        bearing = [j for j, x in enumerate(robot.joints) if x.kind == "revolute" and largest[j] > LEAST_LOAD_NM]
        return [{"joints": (j,), "knee_nm": float(f"{part * largest[j]:.2g}")} for j in bearing for part in KNEES]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints."""
        return self.revolute(robot, "it is a gear")

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Twist b per joint, rad; named with the knee in N mm, for a search tries several."""
        stem = f"strain_wave_{1000.0 * self.knee_nm:.0f}"
        return self.per_joint(
            robot, stem, "rad", math.radians(0.02), 0.0, math.radians(1.0), "twist b below the knee of the load"
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by b."""
        return self.joint_angle(batch, values, np.tanh(batch.axial / self.knee_nm))

    def smooth_over(self, load_nm: float) -> bool:
        """Whether the knee is wider than this."""
        return self.knee_nm > load_nm

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add it as a soft side by the load, where no other effect has one."""
        return form.add_side(self.acting(len(form.joints)), values, self.knee_nm)
