"""What somebody's model of MuJoCo states of its drives, as starting values of effects; and what has no counterpart.

At rest an arm depends on stiffness, friction and backlash. What a model states of motion is named and left.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_client.twin.settled import HINGE, JOINT, find_element_id

LEAST = 1e-12
PARALLEL = 1.0 - 1e-6
WITH_PRIOR = ("backlash_load", "friction_windup")  # effects whose option prior_sigma_rad says how large they may be
SMALLEST_RAD, LARGEST_RAD = 1e-6, 0.035  # of that option


@dataclass(frozen=True)
class Stated:
    """One number of a joint in a model: what the model calls it, its value there, the effect and its value there."""

    joint: str
    source: str
    value: float
    unit: str
    effect: str
    start: float
    start_unit: str


@dataclass(frozen=True)
class Read:
    """Of each joint its stiffness N m/rad (None: nothing drives it); the starting values; sentences on what is left."""

    joints: tuple[str, ...]
    stiffness: tuple[float | None, ...]
    stated: tuple[Stated, ...]
    left: tuple[str, ...]

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Options of a fit that begins with these values: the effects, expected to be as large as the model has them.

        One size counts for all joints of an effect, the largest; that of `axial_compliance` is the robot's to state.
        """
        found: dict[str, dict[str, Any]] = {}
        for one in self.stated:
            effect = found.setdefault(one.effect, {"id": one.effect, "joints": []})
            effect["joints"].append(self.joints.index(one.joint) + 1)
            if one.effect in WITH_PRIOR:
                size = float(f"{min(max(math.radians(one.start), SMALLEST_RAD), LARGEST_RAD):.4g}")
                effect["prior_sigma_rad"] = max(size, effect.get("prior_sigma_rad", 0.0))
        return list(found.values())


def read_drives(model: Any, joints: Sequence[str], path: Path) -> Read:
    """Read the drives of joints, in the robot's order.

    Raises:
        FileError: the model has not these joints.

    """
    places = [find_element_id(model, "joint", name, path) for name in joints]
    drives = {int(model.actuator_trnid[a, 0]): a for a in range(model.nu) if int(model.actuator_trntype[a]) == JOINT}
    gains = [_gain(model, drives.get(j)) for j in places]
    stated = [
        one
        for name, j, gain in zip(joints, places, gains, strict=True)
        for one in _stated_drive_effects(model, name, j, gain)
    ]
    left = tuple(_unmapped_statements(model, list(joints), places, drives, gains))
    return Read(tuple(joints), tuple(gains), tuple(stated), left)


def _gain(model: Any, drive: int | None) -> float | None:
    """Stiffness of a position drive; None of one that holds no position."""
    if drive is None or not float(model.actuator_biasprm[drive, 1]) < 0.0:
        return None
    return -float(model.actuator_biasprm[drive, 1])


def _stated_drive_effects(model: Any, name: str, j: int, gain: float | None) -> Iterator[Stated]:
    hinge = int(model.jnt_type[j]) == HINGE
    if not hinge:
        return
    if gain is not None:
        yield Stated(name, "kp", gain, "N m/rad", "axial_compliance", math.degrees(1.0 / gain), "deg/(N m)")
    friction = float(model.dof_frictionloss[model.jnt_dofadr[j]])
    if friction > LEAST and gain is not None:
        windup = math.degrees(friction / gain)
        yield Stated(name, "frictionloss", friction, "N m", "friction_windup", windup, "deg")
    width = _backlash(model, j)
    if width is not None:
        yield Stated(
            name, "range of a second hinge", math.degrees(width), "deg", "backlash_load", math.degrees(width) / 2, "deg"
        )


def _backlash(model: Any, j: int) -> float | None:
    """Width, rad, of a hinge that nothing drives on the same body and axis, and that has narrow limits."""
    body, driven = int(model.jnt_bodyid[j]), {int(model.actuator_trnid[a, 0]) for a in range(model.nu)}
    for k in range(model.njnt):
        alike = int(model.jnt_bodyid[k]) == body and k != j and k not in driven
        if not alike or int(model.jnt_type[k]) != HINGE or not bool(model.jnt_limited[k]):
            continue
        if abs(float(model.jnt_axis[k] @ model.jnt_axis[j])) > PARALLEL:
            return float(model.jnt_range[k, 1] - model.jnt_range[k, 0])
    return None


def _unmapped_statements(
    model: Any, names: list[str], places: list[int], drives: dict[int, int], gains: list[float | None]
) -> Iterator[str]:
    """What the model states and no pose at rest depends on, or no effect is."""

    def list_nonzero(values: Sequence[float]) -> str:
        return ", ".join(f"{name} {value:g}" for name, value in zip(names, values, strict=True) if abs(value) > LEAST)

    dofs = [int(model.jnt_dofadr[j]) for j in places]
    motion = "an arm at rest does not depend on it"
    told = [
        ("damping", [float(model.dof_damping[d].ravel()[0]) for d in dofs], motion),
        ("armature", [float(model.dof_armature[d]) for d in dofs], motion),
        ("kv of the drive", [_drive_damping(model, drives.get(j)) for j in places], motion),
        (
            "spring of the joint",
            [float(model.jnt_stiffness[j].ravel()[0]) for j in places],
            "no effect is a spring beside the drive; gravity_spring is nearest",
        ),
        (
            "force limit",
            [_drive_force_limit(model, drives.get(j)) for j in places],
            "a drive at its limit is not calibrated",
        ),
    ]
    for what, values, why in told:
        listed = list_nonzero(values)
        if listed:
            yield f"{what} ({listed}): {why}"
    idle = [name for name, gain in zip(names, gains, strict=True) if gain is None]
    if idle:
        yield f"no position drive ({', '.join(idle)}): its stiffness is not stated, a fit finds it where it is large"


def _drive_damping(model: Any, drive: int | None) -> float:
    return 0.0 if drive is None else -float(model.actuator_biasprm[drive, 2])


def _drive_force_limit(model: Any, drive: int | None) -> float:
    limited = drive is not None and bool(model.actuator_forcelimited[drive])
    return float(model.actuator_forcerange[drive, 1]) if limited else 0.0
