"""Payload whose mass or centre is not what was stated, seen through what follows the load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from kilter_core.arm.loads.slopes import NO_COLUMNS, LoadSlopes
from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import LOADS, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class PayloadError(Effect):
    """Mass dm and shift dcom of the payload beyond what was stated, in the rows that carry one of stated mass m > 0.

    The effects beside it that follow loads read the changed load; without any it does nothing. Or, with ``compliances``
    c_j of an earlier identification, one per joint, rad/(N m) (m/N at a prismatic joint), dq_j = c_j (A_j dm + m B_j · dcom).
    A_j is the load of one kilogram at the stated place, B_j that of one kg·m of first moment along the tool axes, so the
    load is linear in dm and m dcom; the product dm dcom is left out. dm is the same in all loaded rows (a forgotten
    adapter), dcom the same shift in the tool frame.
    """

    id = "payload_error"
    summary = "mass or centre of the payload not as stated, seen through what follows the load"
    physical = LOADS
    separated_by = (Separator.LOADS,)
    source = "thesis eq. 4.21 with eq. 4.15, differentiated by the payload"
    needs = frozenset({"payload_kg"})
    aliases = ("axial_compliance", "link_bending")
    remedy = "weigh the payload, or measure with two loads, one of them none"
    at_joints = False
    changes_loads = True

    compliances: tuple[float, ...] = option(
        (),
        "Compliance of each joint, rad/(N m), as identified before; empty: the effects beside it read the changed load.",
    )

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Check that every joint has a compliance, or none; without them one load alone shows nothing.

        Raises:
            OptionError: there is not one compliance per joint, or the rows have one load only.

        """
        if not self.compliances:
            if rows is not None and rows.payload_kg is not None and np.ptp(rows.payload_kg) == 0.0:
                raise OptionError(
                    "payload_error needs rows with two loads, one of which may be none: geometry imitates the sag of one load.",
                    effect=self.id,
                )
            return self
        if len(self.compliances) != robot.n_joints:
            raise OptionError(
                f"payload_error has {len(self.compliances)} compliances for {robot.n_joints} joints: identify "
                "axial_compliance first and give its values in rad/(N m), 0 for a stiff joint; or none, and name effects that "
                "follow the load beside it.",
                effect=self.id,
            )
        return self

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Mass error dm, kg, then the error of the centre dcom along x, y, z of the tool, m."""
        mass = Parameter("payload_mass", "kg", 0.0, 0.5, -10.0, 10.0, "mass of the payload beyond what was stated")
        text = "centre of the payload beyond what was stated, along tool "
        return (mass, *(Parameter(f"payload_com_{k}", "m", 0.0, 0.03, -0.3, 0.3, text + k) for k in "xyz"))

    def load_columns(self, slopes: LoadSlopes) -> tuple[int, ...]:
        """The load errors of the payload, where no compliances say what they do."""
        return NO_COLUMNS if self.compliances else slopes.payload or NO_COLUMNS

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint corrections and their derivatives by dm and dcom; none of its own without compliances."""
        if not self.compliances:
            return Local()
        mass = np.asarray(self.column(batch, "payload_kg"), dtype=np.float64)
        if batch.payload_axial is None:
            raise OptionError("payload_error needs the sensitivity of the loads: make the batch by a model with it.")
        per_unit = np.stack([(mass > 0.0) * 1.0, mass, mass, mass], axis=1)
        signal = np.einsum("njk,nk,j->kjn", batch.payload_axial, per_unit, np.asarray(self.compliances))
        return linear(batch, values, [Derivative(k, j, dq=dq) for k, s in enumerate(signal) for j, dq in enumerate(s)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Change the payload; with compliances of its own it acts in rows that carry one, and cannot be corrected there."""
        if self.compliances:
            return form.conditions.payload_kg == 0.0
        form.payload_errors += values
        return True
