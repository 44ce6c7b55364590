"""A carriage that pitches, yaws and rolls along its travel: a guide that is bent or twisted."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.effects.base import option
from kilter_core.effects.guide import GuideCurves
from kilter_core.effects.physical import GUIDE


@dataclass(frozen=True)
class GuideRotation(GuideCurves):
    """The carriage of prismatic joint i rotates by a smooth curve of the reading: pitch and yaw about x and y, roll about z.

    Its axes are those of the joint frame, its centre the origin of that frame. A constant rotation is geometry, so the
    orders begin at 1: a guide of constant curvature or twist. As with a straightness the name does not say why.
    """

    id = "guide_rotation"
    summary = "carriage of a prismatic joint pitches, yaws and rolls along the travel"
    physical = GUIDE
    source = "ISO 230-1, angular errors of a linear axis (EAX, EBX, ECX)"
    aliases = ("straightness", "telescope_bending", "encoder_scale", "joint_coupling")
    remedy = "put an inclinometer or three reflectors on the carriage and run it over its whole travel"
    stem, components, sigma, wide = "guide", (3, 4, 5), 1e-4, 5e-3

    orders: tuple[int, ...] = option((1, 2, 3), "Orders of the polynomials over the range of the joint.")
