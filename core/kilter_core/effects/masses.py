"""Masses and centres that are not quite as stated: of links, and of the payload."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.load_slopes import NO_COLUMNS, LoadSlopes, links_with_mass
from kilter_core.arm.robot import CENTRE_M, MASS_SHARE, Link, Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import LOADS, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter, Prior
from kilter_core.types import Floats


@dataclass(frozen=True)
class LoadError(Effect):
    """The static load is linear in mass m and first moment m c of each body; the other effects read the changed loads.

    Of each link with a mass: mass beyond what was stated, at the stated centre, and first moment beyond. Of the payload,
    in rows that carry one: mass and shift of its place. ``payload_kg`` is the mean payload of the rows it is identified
    on, which scales the prior of its mass; 0 leaves the payload as stated. Priors are those of the robot, or the same for
    all bodies: ``mass_share`` of the mass, and ``centre_m`` of each coordinate of the centre. Of links that torques tell it is
    what these say.
    """

    id = "load_error"
    summary = "masses and centres of links and payload not as stated, seen through the effects that follow loads"
    physical = LOADS
    source = "thesis eq. 4.21, linear in mass and first moment"
    needs = frozenset({"moments"})
    aliases = ("payload_error",)
    remedy = "weigh the payload, measure poses with another one, or state how well the masses are known"
    at_joints = False
    nuisance = True
    changes_loads = True

    payload_kg: float = option(
        0.0, "Mean payload of the rows, kg, which scales the prior of its mass; 0: the payload is as stated.", low=0.0
    )
    mass_share: float = option(
        0.0, "Standard deviation of every mass as a share of it; 0: what the robot says of each.", low=0.0
    )
    centre_m: float = option(
        0.0, "Standard deviation of each coordinate of every centre, m; 0: what the robot says of each.", low=0.0
    )

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Take the mean payload from the rows."""
        if self.payload_kg > 0.0 or rows is None or rows.payload_kg is None or not np.any(rows.payload_kg > 0.0):
            return self
        return replace(self, payload_kg=float(np.mean(rows.payload_kg[rows.payload_kg > 0.0])))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Mass (kg) and first moment (kg m) of each link with a mass, then mass (kg) and place (m) of the payload."""
        links = [p for k in links_with_mass(robot) for p in _of_link(k + 1, self._link_with_sigmas(robot.links[k]))]
        prior = Prior.from_parameters(links, robot.told_loads)
        told = zip(links, prior.mean.tolist(), prior.sigma.tolist(), strict=True)
        return (*(replace(p, value=mean, prior_sigma=sigma) for p, mean, sigma in told), *self._of_payload(robot))

    def local(self, batch: Batch, values: Floats) -> Local:
        """Nothing of its own."""
        return Local()

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Change the masses that all loads are computed from."""
        form.change_masses(values)
        return True

    def load_columns(self, slopes: LoadSlopes) -> tuple[int, ...]:
        """All load errors, in their order."""
        links = tuple(range(len(slopes) - len(slopes.payload)))
        return links + ((slopes.payload or NO_COLUMNS) if self.payload_kg > 0.0 else ())

    def _link_with_sigmas(self, link: Link) -> Link:
        """The link with its standard deviations, those of the options before its own."""
        mass = self.mass_share * link.mass if self.mass_share > 0.0 else link.mass_sigma
        return replace(link, mass_sigma=mass, com_sigma=self.centre_m if self.centre_m > 0.0 else link.com_sigma)

    def _of_payload(self, robot: Robot) -> tuple[Parameter, ...]:
        if not self.payload_kg > 0.0:
            return ()
        share, centre = self.mass_share or robot.payload_sigma[0], self.centre_m or robot.payload_sigma[1]
        most = 10.0 * self.payload_kg
        mass = Parameter(
            "load_payload_mass",
            "kg",
            0.0,
            share * self.payload_kg,
            -most,
            most,
            "mass of the payload beyond what was stated",
        )
        text = "centre of the payload beyond what was stated, along tool "
        return (mass, *(Parameter(f"load_payload_{k}", "m", 0.0, centre, -0.3, 0.3, text + k) for k in "xyz"))


def _of_link(number: int, link: Link) -> tuple[Parameter, ...]:
    mass = MASS_SHARE * link.mass if link.mass_sigma is None else link.mass_sigma
    moment = link.mass * (CENTRE_M if link.com_sigma is None else link.com_sigma)
    text = f"mass of link {number} beyond what was stated"
    first = f"first moment of link {number} beyond what was stated, along its "
    return (
        Parameter(f"link_mass_{number}", "kg", 0.0, mass, -link.mass, link.mass, text),
        *(Parameter(f"link_moment_{k}_{number}", "kg m", 0.0, moment, -link.mass, link.mass, first + k) for k in "xyz"),
    )


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
