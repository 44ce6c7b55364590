"""Robot documents: `robot.json`, in mm and degrees, in every convention."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from service.contract.complete_models import CpcFlange, CpcRow, McpcFlange, McpcRow, PoeAxis, SModelRow
from service.contract.units import MAX_ELEMENTS, MAX_JOINTS, JointType, Name, Pose, Strict, Vector

Axis = Literal["Rx", "Ry", "Rz", "Tx", "Ty", "Tz"]
Range = tuple[FiniteFloat, FiniteFloat]


class Joint(Strict):
    """A joint; limits in degrees, in mm when it is prismatic."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    limits_deg: Range | None = None
    limits_mm: Range | None = None
    gear_ratio: FiniteFloat | None = None


Joints = Annotated[list[Joint], Field(max_length=MAX_JOINTS)]
MAX_AXES = 4 * MAX_JOINTS  # a joint may drive several


class Link(Strict):
    """Mass, centre of mass, and inertia about it as xx, yy, zz, xy, xz, yz, in the link's frame.

    ``mass_sigma_kg`` and ``com_sigma_mm`` are standard deviations; a tenth of the mass and 10 mm when left out.
    """

    mass_kg: Annotated[FiniteFloat, Field(ge=0)] = 0.0
    com_mm: Vector = (0.0, 0.0, 0.0)
    inertia_kg_m2: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] = (0.0,) * 6
    mass_sigma_kg: Annotated[FiniteFloat, Field(gt=0)] | None = None
    com_sigma_mm: Annotated[FiniteFloat, Field(gt=0)] | None = None


class Element(Strict):
    """An elementary transform: a constant (mm or degrees), or a joint with ratio and zero offset."""

    axis: Axis
    name: Annotated[str, Field(min_length=1, max_length=128)] | None = None
    value: FiniteFloat | None = None
    joint: Annotated[str, Field(max_length=128)] | None = None
    ratio: FiniteFloat | None = None
    fixed: bool | None = None
    spare: bool | None = None


class DhRow(Strict):
    """A row of standard Denavit-Hartenberg parameters."""

    theta_offset_deg: FiniteFloat = 0.0
    d_mm: FiniteFloat = 0.0
    a_mm: FiniteFloat = 0.0
    alpha_deg: FiniteFloat = 0.0
    type: JointType = "revolute"


class MdhRow(Strict):
    """A row of Craig's parameters: alpha, a and beta are those of i-1; a row with beta is Hayati's."""

    alpha_deg: FiniteFloat = 0.0
    a_mm: FiniteFloat = 0.0
    beta_deg: FiniteFloat | None = None
    theta_offset_deg: FiniteFloat = 0.0
    d_mm: FiniteFloat | None = 0.0
    type: JointType = "revolute"


class PayloadSigma(Strict):
    """How well payloads are known, as standard deviations; 10 % and 10 mm when left out."""

    mass_percent: Annotated[FiniteFloat, Field(gt=0)] | None = None
    com_mm: Annotated[FiniteFloat, Field(gt=0)] | None = None


class _Robot(Strict):
    name: Name
    source: Annotated[str, Field(max_length=2000)] | None = None
    gravity_m_s2: Vector | None = None
    links: Annotated[list[Link], Field(max_length=MAX_JOINTS)] | None = None
    tool: Pose | None = None
    base: Pose | None = None
    payload_sigma: PayloadSigma | None = None


class ChainRobot(_Robot):
    """A robot as a row of elementary transforms."""

    convention: Literal["chain"]
    joints: Joints
    elements: Annotated[list[Element], Field(min_length=1, max_length=MAX_ELEMENTS)]


class DhRobot(_Robot):
    """A robot as Denavit-Hartenberg rows."""

    convention: Literal["dh"]
    joints: Joints | None = None
    rows: Annotated[list[DhRow], Field(min_length=1, max_length=MAX_JOINTS)]


class MdhRobot(_Robot):
    """A robot as modified Denavit-Hartenberg or Hayati rows."""

    convention: Literal["mdh"]
    joints: Joints | None = None
    rows: Annotated[list[MdhRow], Field(min_length=1, max_length=MAX_JOINTS)]


class SModelRobot(_Robot):
    """A robot as rows of Stone's S-model."""

    convention: Literal["s_model"]
    joints: Joints | None = None
    rows: Annotated[list[SModelRow], Field(min_length=1, max_length=MAX_JOINTS)]


class PoeRobot(_Robot):
    """A robot as a product of exponentials: its axes at zero, and the flange there."""

    convention: Literal["poe"]
    joints: Joints | None = None
    axes: Annotated[list[PoeAxis], Field(min_length=1, max_length=MAX_AXES)]
    home: Pose = Pose()


class CpcRobot(_Robot):
    """A robot as rows of the complete and parametrically continuous model."""

    convention: Literal["cpc"]
    joints: Joints | None = None
    rows: Annotated[list[CpcRow], Field(min_length=1, max_length=MAX_JOINTS)]
    flange: CpcFlange = CpcFlange()


class McpcRobot(_Robot):
    """A robot as rows of the modified CPC model."""

    convention: Literal["mcpc"]
    joints: Joints | None = None
    rows: Annotated[list[McpcRow], Field(min_length=1, max_length=MAX_JOINTS)]
    flange: McpcFlange = McpcFlange()


class UrdfRobot(_Robot):
    """A robot as a URDF; joints, limits and masses are the URDF's, ``joints`` may add gear ratios and limits."""

    convention: Literal["urdf"]
    joints: Joints | None = None
    urdf: Annotated[str, Field(min_length=1)]
    base_link: Annotated[str, Field(max_length=128)]
    tip_link: Annotated[str, Field(max_length=128)]


class PresetRobot(_Robot):
    """A robot that ships with Kilter."""

    convention: Literal["preset"]
    preset: Annotated[str, Field(max_length=64)]


RobotDocument = Annotated[
    ChainRobot | DhRobot | MdhRobot | SModelRobot | PoeRobot | CpcRobot | McpcRobot | UrdfRobot | PresetRobot,
    Field(discriminator="convention"),
]
Target = Literal["chain", "dh", "mdh", "s_model", "poe", "cpc", "mcpc", "urdf"]
