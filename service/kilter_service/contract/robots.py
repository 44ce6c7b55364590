"""Robot documents: `robot.json`, in mm and degrees, in every convention."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.units import (
    COMPENSATION,
    DRIVE,
    MAX_ELEMENTS,
    MAX_JOINTS,
    ControllerCompensation,
    Deg,
    Direction,
    Drive,
    JointType,
    Kg,
    KgM2,
    Listed,
    Load,
    Mm,
    MPerS2,
    Name,
    Percent,
    PointMm,
    Pose,
    Strict,
)

MeshUnit = Literal["mm", "m"]


class Mesh(Strict):
    """The shape of a link. It is drawn only: no load and no identification uses it."""

    robot: str = Field(description="Name of the robot.")
    link: str = Field(description="Name of the joint that moves the link, or `base`.")
    format: Literal["stl", "obj"] = Field(description="Format of the file.")
    unit: MeshUnit = Field(description="Unit of the coordinates of the file: mm or m.")
    triangles: int = Field(description="Number of triangles.")
    sha256: str = Field(description="SHA-256 of the file, 64 hexadecimal digits.")
    created_at: datetime = Field(description="When it was stored.")


class UrdfShape(Strict):
    """A shape that the robot's URDF gives a link: a file, or a box, cylinder or sphere."""

    link: str = Field(description="Name of the joint that moves the link, or `base`.")
    urdf_link: str = Field(description="The URDF's name of the link.")
    file: str | None = Field(
        None, description="File of the mesh, in the URDF's words; null: a body of the sizes below."
    )
    scale: tuple[float, float, float] = Field((1.0, 1.0, 1.0), description="Factors of the file's coordinates to m.")
    box_mm: tuple[float, float, float] | None = Field(None, description="Sizes of a box about its centre, mm.")
    cylinder_mm: tuple[float, float] | None = Field(
        None, description="Radius and length of a cylinder along z about its centre, mm."
    )
    sphere_mm: float | None = Field(None, description="Radius of a sphere, mm.")
    transform: list[list[float]] = Field(
        description="Rows (4 by 4) that take the shape's own coordinates in mm to those of the link's mesh."
    )


class UrdfShapes(Strict):
    """What the robot's URDF draws of the arm."""

    shapes: list[UrdfShape] = Field(description="Shapes, from base to tool.")
    left_out: list[str] = Field(description="The URDF's links behind joints that follow another: they have no mesh.")


class MeshList(Listed):
    """The shapes of a robot's links, from base to tool."""

    meshes: list[Mesh] = Field(description="Shapes, from base to tool.")


TYPE = "Whether the joint is revolute or prismatic."
ZERO = "Added to the joint reading, degrees; mm for a prismatic joint."


class PoeAxis(Strict):
    """A moving axis at zero, in the base frame; the joint that drives it, times ratio (default: the next joint)."""

    direction: Direction = Field(
        description="Direction of the axis with all joints at zero; its length does not matter."
    )
    point_mm: PointMm = Field((0.0, 0.0, 0.0), description="A point on the axis with all joints at zero, mm.")
    type: JointType = Field("revolute", description=TYPE)
    joint: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        None, description="Name of the joint that drives the axis; null: the next joint."
    )
    ratio: float = Field(1.0, description="Motion of the axis per motion of the joint, no unit.")
    drive: Drive | None = Field(None, description=DRIVE)


class CpcRow(Strict):
    """Direction of the next axis in the frame before, and its shift; then the joint."""

    b: Direction = Field(description="Direction of the axis in the frame before, a vector of any length.")
    x_mm: Mm = Field(0.0, description="Shift of the axis along x, mm.")
    y_mm: Mm = Field(0.0, description="Shift of the axis along y, mm.")
    theta_offset_deg: Deg = Field(0.0, description=ZERO)
    type: JointType = Field("revolute", description=TYPE)


class CpcFlange(Strict):
    """R(b) Rz(beta) Tx Ty Tz after the last joint."""

    b: Direction = Field((0.0, 0.0, 1.0), description="Direction of the flange's z axis in the last joint's frame.")
    beta_deg: Deg = Field(0.0, description="Rotation about that direction, degrees.")
    x_mm: Mm = Field(0.0, description="Shift along x, mm.")
    y_mm: Mm = Field(0.0, description="Shift along y, mm.")
    z_mm: Mm = Field(0.0, description="Shift along z, mm.")


class McpcRow(Strict):
    """Rx(alpha) Ry(beta) Tx(x) Ty(y), then the joint."""

    alpha_deg: Deg = Field(0.0, description="Rotation about x, degrees.")
    beta_deg: Deg = Field(0.0, description="Rotation about y, degrees.")
    x_mm: Mm = Field(0.0, description="Shift along x, mm.")
    y_mm: Mm = Field(0.0, description="Shift along y, mm.")
    theta_offset_deg: Deg = Field(0.0, description=ZERO)
    type: JointType = Field("revolute", description=TYPE)


class McpcFlange(Strict):
    """Rx(alpha) Ry(beta) Rz(gamma) Tx Ty Tz after the last joint."""

    alpha_deg: Deg = Field(0.0, description="Rotation about x, degrees.")
    beta_deg: Deg = Field(0.0, description="Rotation about y, degrees.")
    gamma_deg: Deg = Field(0.0, description="Rotation about z, degrees.")
    x_mm: Mm = Field(0.0, description="Shift along x, mm.")
    y_mm: Mm = Field(0.0, description="Shift along y, mm.")
    z_mm: Mm = Field(0.0, description="Shift along z, mm.")


class SModelRow(Strict):
    """Tz(d) Rz(theta) Tx(a) Rx(alpha) Rz(gamma) Tz(b)."""

    theta_offset_deg: Deg = Field(0.0, description=ZERO)
    d_mm: Mm = Field(0.0, description="Shift along the joint's axis, mm.")
    a_mm: Mm = Field(0.0, description="Length of the link, mm.")
    alpha_deg: Deg = Field(0.0, description="Twist of the link, degrees.")
    gamma_deg: Deg = Field(0.0, description="Rotation of the link's frame about the next axis, degrees.")
    b_mm: Mm = Field(0.0, description="Shift of the link's frame along the next axis, mm.")
    type: JointType = Field("revolute", description=TYPE)


Axis = Literal["Rx", "Ry", "Rz", "Tx", "Ty", "Tz"]
JOINTS = "Joints from base to tool; at most 32. Null: named j1, j2, ... without limits."
STIFFNESS = (
    "Rough stiffness of the drive of a revolute joint, N m/rad, above 0: a fit expects a compliance of its size; null: that "
    "of an industrial gear, 10 000."
)
ROWS = "A row for each joint, from base to tool; at most 32."


class Joint(Strict):
    """A joint; limits in degrees, in mm when it is prismatic."""

    name: Annotated[str, Field(min_length=1, max_length=64)] = Field(
        description="Name of the joint, unique in the robot."
    )
    limits_deg: tuple[Deg, Deg] | None = Field(
        None, description="Lowest and highest reading of a revolute joint, degrees; null: not limited."
    )
    limits_mm: tuple[Mm, Mm] | None = Field(
        None, description="Lowest and highest reading of a prismatic joint, mm; null: not limited."
    )
    gear_ratio: float | None = Field(
        None, description="Turns of the motor per turn of the joint, no unit; gear errors need it."
    )
    drive_stiffness_nm_rad: Annotated[float, Field(gt=0)] | None = Field(None, description=STIFFNESS)
    drive: Drive | None = Field(None, description=f"Only of a mimic joint of a URDF. {DRIVE}")


Joints = Annotated[list[Joint], Field(max_length=MAX_JOINTS)]
MAX_AXES = 4 * MAX_JOINTS  # a joint may drive several


class Link(Strict):
    """Mass, centre of mass, and inertia about it as xx, yy, zz, xy, xz, yz, in the link's frame.

    ``mass_sigma_kg`` and ``com_sigma_mm`` are standard deviations; a tenth of the mass and 10 mm when left out.
    """

    mass_kg: Load = Field(0.0, description="Mass of the link, kg, 0 or more.")
    on_axis: Annotated[int, Field(ge=1, le=MAX_ELEMENTS)] | None = Field(
        None,
        description="Moving axis that the body moves with, counted from the base from 1, where a joint drives several "
        "(mimic, parallelogram) and it is not the joint's own; null: the link of a joint, in their order.",
    )
    com_mm: PointMm = Field((0.0, 0.0, 0.0), description="Centre of mass in the link's frame, mm.")
    inertia_kg_m2: tuple[KgM2, KgM2, KgM2, KgM2, KgM2, KgM2] = Field(
        (0.0,) * 6, description="Inertia about the centre of mass: xx, yy, zz, xy, xz, yz, kg m2."
    )
    mass_sigma_kg: Annotated[Kg, Field(gt=0)] | None = Field(
        None, description="Standard deviation of the mass, kg, above 0; null: a tenth of the mass."
    )
    com_sigma_mm: Annotated[Mm, Field(gt=0)] | None = Field(
        None, description="Standard deviation of each coordinate of the centre, mm, above 0; null: 10 mm."
    )


class Element(Strict):
    """An elementary transform: a constant (mm or degrees), or a joint with ratio and zero offset."""

    axis: Axis = Field(description="Rotation (R) about or shift (T) along an axis of the frame reached so far.")
    name: Annotated[str, Field(min_length=1, max_length=128)] | None = Field(
        None, description="Name of the constant, or of the joint's zero offset, as a parameter."
    )
    value: float | None = Field(None, description="Value: degrees for a rotation, mm for a shift.")
    joint: Annotated[str, Field(max_length=128)] | None = Field(None, description="Name of the joint that moves it.")
    ratio: float | None = Field(
        None, description="Motion of the element per motion of the joint, no unit; -1 reverses the axis. Null: 1."
    )
    drive: Drive | None = Field(None, description=DRIVE)
    fixed: bool | None = Field(None, description="Whether the element is never identified.")
    spare: bool | None = Field(None, description="Whether it is identified only at level 1 or when `free` names it.")


class DhRow(Strict):
    """A row of standard Denavit-Hartenberg parameters."""

    theta_offset_deg: Deg = Field(0.0, description="Added to the reading of a revolute joint, degrees.")
    d_mm: Mm = Field(0.0, description="Shift along the joint's axis, mm.")
    a_mm: Mm = Field(0.0, description="Length of the link, mm.")
    alpha_deg: Deg = Field(0.0, description="Twist of the link, degrees.")
    type: JointType = Field("revolute", description="Whether the joint is revolute or prismatic.")


class MdhRow(Strict):
    """A row of Craig's parameters: alpha, a and beta are those of i-1; a row with beta is Hayati's."""

    alpha_deg: Deg = Field(0.0, description="Twist of the link before, degrees.")
    a_mm: Mm = Field(0.0, description="Length of the link before, mm.")
    beta_deg: Deg | None = Field(
        None,
        description="Hayati's rotation about y, degrees, for an axis parallel to the one before; null: Craig's row.",
    )
    theta_offset_deg: Deg = Field(0.0, description="Added to the reading of a revolute joint, degrees.")
    d_mm: Mm | None = Field(0.0, description="Shift along the joint's axis, mm; null in a row of Hayati's.")
    type: JointType = Field("revolute", description="Whether the joint is revolute or prismatic.")


class PayloadSigma(Strict):
    """How well payloads are known, as standard deviations; 10 % and 10 mm when left out."""

    mass_percent: Annotated[Percent, Field(gt=0)] | None = Field(
        None, description="Standard deviation of a payload's mass in percent of it, above 0; null: 10 %."
    )
    com_mm: Annotated[Mm, Field(gt=0)] | None = Field(
        None, description="Standard deviation of each coordinate of a payload's centre, mm, above 0; null: 10 mm."
    )


class DefaultLoad(Strict):
    """What a robot carries where a campaign or a path states no payload."""

    payload_kg: Load = Field(description="Mass of the load, kg, 0 or more.")
    payload_com_mm: PointMm = Field((0.0, 0.0, 0.0), description="Its centre in the tool frame, mm; the tool point.")


class _Robot(Strict):
    name: Name = Field(
        description="Name of the robot, unique on the server: letters, digits, `_`, `.` and `-`, at most 64."
    )
    source: Annotated[str, Field(max_length=2000)] | None = Field(
        None, description="Where the numbers come from, in words."
    )
    gravity_m_s2: tuple[MPerS2, MPerS2, MPerS2] | None = Field(
        None, description="Gravity in the robot's base frame, m/s2; null: [0, 0, -9.80665], an arm mounted upright."
    )
    links: Annotated[list[Link], Field(max_length=MAX_ELEMENTS)] | None = Field(
        None,
        description="Masses of the links, one for each joint, then those on further axes of a joint (`on_axis`); effects "
        "that follow the load need them.",
    )
    tool: Pose | None = Field(None, description="The tool point in the flange's frame; null: the flange.")
    base: Pose | None = Field(None, description="Pose of the robot's base in the world; null: they coincide.")
    load: DefaultLoad | None = Field(
        None, description="What it carries where a campaign or a path states no payload; null: nothing is known."
    )
    payload_sigma: PayloadSigma | None = Field(None, description="How well payloads are known; null: 10 % and 10 mm.")
    controller_compensation: ControllerCompensation | None = Field(
        None, description=f"{COMPENSATION} A setting of the robot, which no hash covers; null: `unknown`."
    )


class ChainRobot(_Robot):
    """A robot as a row of elementary transforms."""

    convention: Literal["chain"] = Field(description="Elementary transforms, one after the other.")
    joints: Joints = Field(description="Joints from base to tool; at most 32.")
    elements: Annotated[list[Element], Field(min_length=1, max_length=MAX_ELEMENTS)] = Field(
        description="Elementary transforms from base to flange; at most 512."
    )


class DhRobot(_Robot):
    """A robot as Denavit-Hartenberg rows."""

    convention: Literal["dh"] = Field(description="Standard Denavit-Hartenberg: Tz(d) Rz(theta) Tx(a) Rx(alpha).")
    joints: Joints | None = Field(None, description=JOINTS)
    rows: Annotated[list[DhRow], Field(min_length=1, max_length=MAX_JOINTS)] = Field(description=ROWS)


class MdhRobot(_Robot):
    """A robot as modified Denavit-Hartenberg or Hayati rows."""

    convention: Literal["mdh"] = Field(description="Modified (Craig's): Rx(alpha) Tx(a) Rz(theta) Tz(d).")
    joints: Joints | None = Field(None, description=JOINTS)
    rows: Annotated[list[MdhRow], Field(min_length=1, max_length=MAX_JOINTS)] = Field(description=ROWS)


class SModelRobot(_Robot):
    """A robot as rows of Stone's S-model."""

    convention: Literal["s_model"] = Field(description="Stone's S-model, six numbers a row.")
    joints: Joints | None = Field(None, description=JOINTS)
    rows: Annotated[list[SModelRow], Field(min_length=1, max_length=MAX_JOINTS)] = Field(description=ROWS)


class PoeRobot(_Robot):
    """A robot as a product of exponentials: its axes at zero, and the flange there."""

    convention: Literal["poe"] = Field(description="Product of exponentials.")
    joints: Joints | None = Field(None, description=JOINTS)
    axes: Annotated[list[PoeAxis], Field(min_length=1, max_length=MAX_AXES)] = Field(
        description="Moving axes from base to flange; at most 128."
    )
    home: Pose = Field(Pose(), description="The flange in the base frame with all joints at zero.")


class CpcRobot(_Robot):
    """A robot as rows of the complete and parametrically continuous model."""

    convention: Literal["cpc"] = Field(description="Complete and parametrically continuous model.")
    joints: Joints | None = Field(None, description=JOINTS)
    rows: Annotated[list[CpcRow], Field(min_length=1, max_length=MAX_JOINTS)] = Field(description=ROWS)
    flange: CpcFlange = Field(CpcFlange(), description="The flange in the last joint's frame.")


class McpcRobot(_Robot):
    """A robot as rows of the modified CPC model."""

    convention: Literal["mcpc"] = Field(description="Modified CPC model.")
    joints: Joints | None = Field(None, description=JOINTS)
    rows: Annotated[list[McpcRow], Field(min_length=1, max_length=MAX_JOINTS)] = Field(description=ROWS)
    flange: McpcFlange = Field(McpcFlange(), description="The flange in the last joint's frame.")


class UrdfRobot(_Robot):
    """A robot as a URDF; joints, limits and masses are the URDF's, ``joints`` may add gear ratios and limits."""

    convention: Literal["urdf"] = Field(description="A URDF and the two links between which the arm is.")
    joints: Joints | None = Field(None, description="Gear ratios and limits to add to joints of the URDF, by name.")
    urdf: Annotated[str, Field(min_length=1)] = Field(description="Text of the URDF.")
    base_link: Annotated[str, Field(max_length=128)] = Field(description="Link that carries the arm.")
    tip_link: Annotated[str, Field(max_length=128)] = Field(description="Link that is the flange.")


class PresetRobot(_Robot):
    """A robot that ships with Kilter."""

    convention: Literal["preset"] = Field(description="A robot that ships with Kilter.")
    preset: Annotated[str, Field(max_length=64)] = Field(description="Name of the preset.")


RobotDocument = Annotated[
    ChainRobot | DhRobot | MdhRobot | SModelRobot | PoeRobot | CpcRobot | McpcRobot | UrdfRobot | PresetRobot,
    Field(discriminator="convention"),
]
Target = Literal["chain", "dh", "mdh", "s_model", "poe", "cpc", "mcpc", "urdf"]
