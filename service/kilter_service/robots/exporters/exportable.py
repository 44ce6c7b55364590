"""What an exporter receives and returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from kilter_core.types import Floats
from kilter_service.contract.versions import Version
from kilter_service.ground.core import core_model, transforms

if TYPE_CHECKING:
    from kilter_core.arm import Robot, Screws
    from kilter_core.effects import Effect
    from kilter_core.identify import FleetVersion
    from kilter_core.model import Calibration, Loss


class Arm(Protocol):
    """A robot as it is stored: the document it was posted as, and the chain that represents it."""

    @property
    def document(self) -> dict[str, Any]:
        """The robot as posted."""

    @property
    def chain(self) -> dict[str, Any] | None:
        """The resolved chain (SI); None for a robot from before the chains that no longer resolves."""

    def robot(self) -> Robot:
        """Build core's robot from the chain."""


@dataclass(frozen=True)
class Exportable:
    """A version: its robot as stored, the version as the API shows it, and core's calibration document (SI).

    Ranges cover ``ranges_percent``; ``fleet`` are versions of other robots of the type, for theirs.
    """

    arm: Arm
    version: Version
    document: dict[str, Any]
    rules: dict[str, Any] | None = None  # that it was activated under
    ranges_percent: float = 95.0
    fleet: tuple[FleetVersion, ...] = ()

    @property
    def robot(self) -> dict[str, Any]:
        """The robot as posted."""
        return self.arm.document

    @cached_property
    def calibration(self) -> core_model.Calibration:
        """Core's calibration."""
        return core_model.Calibration.from_document(self.arm.robot(), self.document)


class Written(NamedTuple):
    """A file's text, its bytes where it is none, or what makes either, and notes on what it leaves out of the version."""

    text: str | bytes | Callable[[], str | bytes]
    notes: tuple[str, ...] = ()


SAID_MM = 1e-6  # smaller differences are rounding


def omissions(calibration: Calibration, arm: Screws | None = None) -> tuple[str, ...]:
    """Say which effects a file of the identified geometry (or ``arm``, base to tool) leaves out, and the distance left."""
    return (*left_out(calibration), distance(core_model.geometry_loss(calibration, arm)))


def left_out(calibration: Calibration) -> tuple[str, ...]:
    """Name the effects of the arm, none of which the file can hold, and how far each moves the tool."""
    sizes = displacements_mm(calibration)
    arm = [effect for effect in calibration.model.effects if effect.stage != "measurement"]
    return tuple(f"Left out: {_describe_effect(effect, sizes.get(effect.id))}." for effect in arm)


def masses_as_stated(robot: Robot) -> tuple[str, ...]:
    """Say what a table of masses leaves out: how well they are known."""
    if not any(link.mass_sigma is not None or link.com_sigma is not None for link in robot.links):
        return ()
    return ("Left out: the standard deviations of masses and centres; the numbers are those the robot states.",)


def displacements_mm(calibration: Calibration) -> dict[str, tuple[float, float]]:
    """Root mean square and largest displacement (mm) of the tool by each effect, over the workspace at rest."""
    kept = calibration.with_effects([effect for effect in calibration.model.effects if core_model.acts_at_rest(effect)])
    found = kept.model.contribution(core_model.workspace(calibration.robot), kept.values)
    moved = {name.partition("#")[0]: np.linalg.norm(d, axis=1) * 1e3 for name, d in found.items()}
    return {name: (float(np.sqrt(np.mean(d**2))), float(d.max())) for name, d in moved.items()}


def _describe_effect(effect: Effect, size: tuple[float, float] | None) -> str:
    if size is None:
        return f"{effect.id}, which acts with {', '.join(sorted(effect.needs - {'moments'}))}"
    return f"{effect.id}, {size[0]:.3f} mm rms and {size[1]:.3f} mm at most over the workspace, at rest without load"


def distance(loss: Loss) -> str:
    """Say how far the file's arm is from the identified one."""
    if loss.max_m * 1e3 < SAID_MM:
        return "Nothing is lost: the poses are those of the version."
    return (
        f"Lost: the file's tool point differs from the version's by {loss.rms_m * 1e3:.4f} mm rms, "
        f"{loss.max_m * 1e3:.4f} mm at most, its orientation by {np.degrees(loss.max_rad):.4f} deg at most, "
        "over the workspace."
    )


CUT = -np.radians(179.0)


def set_origin(joint: Element, T: Floats) -> None:
    """Write a pose (4, 4) as the origin of a joint, with every digit that counts."""
    origin = joint.find("origin")
    origin = SubElement(joint, "origin") if origin is None else origin
    xyz, rpy = transforms.xyz_rpy_from_pose(T)
    origin.set("xyz", numbers(xyz))
    origin.attrib.pop("quat_xyzw", None)
    origin.set("rpy", numbers(away_from_the_cut(rpy)))


def away_from_the_cut(angles: Floats) -> Floats:
    """Angles (rad) from -179 to 181 degrees: drawings have 180 degrees often, whose sign rounding must not change."""
    return np.where(angles < CUT, angles + 2.0 * np.pi, angles)


def numbers(values: Floats) -> str:
    """Numbers as an attribute of URDF."""
    return " ".join(repr(float(value) + 0.0) for value in values)
