"""Tilt of fixed size inside the clearance of a joint, towards the transverse load (thesis 4.10-4.14, 5.15-5.18)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import SOFTENING, Derivative, Local, SignedByLoad, option, soft_sign
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_TILT, Separator
from kilter_core.errors import OptionError
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ClearanceTilt(SignedByLoad):
    """The joint tilts by its clearance angle C about x and y of its frame.

    With t = tan C and γ the share of the load about x, δα = sign(ηx) t sin γ / √(1 + (t sin γ)²) and
    δβ = sign(ηy) t cos γ / √(1 + (t cos γ)²): L of eq. 5.17-5.18 drops out once 5.15 is corrected to r = (L/2) tan C.
    ``share`` "thesis" is eq. 5.16, γ = (π/2)|ηx| / (|ηx| + |ηy|); "vector" is atan2(|ηx|, |ηy|), invariant when the
    joint frame is rotated about its axis. ``softening_nm`` > 0 replaces the sign by a tanh of that half-width.
    """

    id = "clearance_tilt"
    summary = "tilt of fixed size towards the transverse load, by joint clearance"
    physical = JOINT_TILT
    separated_by = (Separator.LOADS,)
    source = "thesis eq. 5.16-5.18, 5.15 corrected"
    needs = frozenset({"moments"})
    sided = True
    about = False
    reads = (("wrench", (3, 4)),)
    signs = "positive"
    aliases = ("radial_compliance", "link_bending", "base_compliance")
    remedy = (
        "measure poses in which the transverse load rotates about the joint, or the same poses with another payload"
    )

    share: str = option(
        "thesis",
        "How the load is shared among x and y: `thesis` (eq. 5.16) or `vector`, independent of the joint frame's rotation.",
        choices=("thesis", "vector"),
    )
    softening_nm: float | tuple[float, ...] = option(0.0, SOFTENING, low=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.share not in ("thesis", "vector"):
            raise OptionError(f"clearance_tilt has share {self.share!r}: give thesis or vector.", effect=self.id)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Clearance angle C per joint, rad."""
        return self.per_joint(
            robot, "clearance", "rad", math.radians(0.1), 0.0, math.radians(1.0), "clearance angle C", rotates=True
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist (0, 0, 0, δα, δβ, 0) per joint and its derivative by C."""
        n = batch.q.shape[1]
        xi = np.zeros((len(batch), n, 6))
        derivatives = []
        for k, j in enumerate(self.acting(n)):
            across, about, _ = self._directions(batch, k, j)
            t = math.tan(values[k])
            dt = 1.0 + t * t
            slope = np.zeros((len(batch), 6))
            for column, part in ((3, across), (4, about)):
                scale = 1.0 / np.sqrt(1.0 + (t * part) ** 2)
                xi[:, j, column] = t * part * scale
                slope[:, column] = dt * part * scale**3
            derivatives.append(Derivative(k, j, xi=slope))
        return Local(xi=xi, derivatives=tuple(derivatives))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the tilts, where no other effect has one."""
        joints = self.acting(len(form.joints))
        if not form.free("tilt", joints):
            return False
        for j, value, width in zip(joints, values.tolist(), form.softening(self.softening_nm, joints), strict=True):
            joint = form.joints[j]
            joint.tilt, joint.tilt_softening_nm = math.tan(value), width
            joint.tilt_by_vector = self.share == "vector"
        return True

    def doubt(self, batch: Batch, values: Floats) -> tuple[Derivative, ...]:
        """Scatter of each sign s around its expectation, √(1 − s²), times the tilt."""
        out = []
        for k, j in enumerate(self.acting(batch.q.shape[1])):
            if values[k] == 0.0:
                continue
            for column, left in zip((3, 4), self._directions(batch, k, j)[2], strict=True):
                xi = np.zeros((len(batch), 6))
                xi[:, column] = math.tan(values[k]) * left
                out.append(Derivative(k, j, xi=xi))
        return tuple(out)

    def _directions(self, batch: Batch, place: int, joint: int) -> tuple[Floats, Floats, tuple[Floats, Floats]]:
        """Signed shares of the tilt about x and y, and how far each may be off; no load, no tilt."""
        mx, my = batch.sided_moment[:, joint, 0], batch.sided_moment[:, joint, 1]
        ax, ay = np.abs(mx), np.abs(my)
        total = ax + ay
        # Rounding noise must not decide where a joint without transverse load tilts.
        loaded = total > 1e-9
        share = ax / np.where(loaded, total, 1.0)
        gamma = share * (math.pi / 2.0) if self.share == "thesis" else np.arctan2(ax, ay)
        width = self.sign_half_width(batch, place, joint)
        sx, sy = (np.where(loaded, soft_sign(m, width), 0.0) for m in (mx, my))
        along, beside = np.sin(gamma), np.cos(gamma)
        return sx * along, sy * beside, (along * np.sqrt(1.0 - sx**2), beside * np.sqrt(1.0 - sy**2))
