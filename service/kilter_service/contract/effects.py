"""The effects by name and as documents, made from core/kilter_core/effects by `make contract`: change them there."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from kilter_service.contract.effect_options import (
    AxialComplianceEffect,
    BacklashEffect,
    BacklashLoadEffect,
    ClearanceTiltEffect,
    DirectionComplianceEffect,
    EccentricityEffect,
    EncoderScaleEffect,
    FrictionWindupEffect,
    GearErrorEffect,
    GravitySpringEffect,
    GuideRotationEffect,
    HardeningEffect,
    JointCouplingEffect,
    LinkBendingEffect,
    LinkGrowthEffect,
    LinkTorsionEffect,
    RadialComplianceEffect,
    ReadingTiltEffect,
    SecondHarmonicEffect,
    StraightnessEffect,
    TelescopeBendingEffect,
    TrackingLagEffect,
    UnknownJointCurveEffect,
    UnknownSmoothCurveEffect,
    ZeroDriftEffect,
    ZeroStepEffect,
    ZeroThermalEffect,
)
from kilter_service.contract.whole_effect_options import (
    BaseComplianceEffect,
    BaseStepEffect,
    ColumnBendingEffect,
    DriftEffect,
    LoadErrorEffect,
    MeasuredTiltEffect,
    MeasurementScaleEffect,
    PayloadErrorEffect,
    RandomWalkEffect,
    SessionShiftEffect,
    SettlingEffect,
    ThermalDriftEffect,
    ThermalGrowthEffect,
    TimeOffsetEffect,
    ToolSagEffect,
    ToolStepEffect,
    UnknownFieldEffect,
    UnknownResidualEffect,
)

# fmt: off
EffectName = Literal[
    "clearance_tilt", "backlash", "backlash_load", "axial_compliance", "radial_compliance", "eccentricity",
    "second_harmonic", "gear_error", "encoder_scale", "joint_coupling", "gravity_spring", "link_bending",
    "link_torsion", "base_compliance", "thermal_growth", "payload_error", "friction_windup", "time_offset",
    "tracking_lag", "drift", "measurement_scale", "session_shift", "zero_drift", "zero_thermal", "link_growth",
    "settling", "random_walk", "base_step", "tool_step", "zero_step", "column_bending", "thermal_drift",
    "measured_tilt", "tool_sag", "hardening", "direction_compliance", "reading_tilt", "straightness",
    "guide_rotation", "telescope_bending", "unknown_smooth_curve", "unknown_joint_curve", "unknown_field",
    "unknown_residual", "load_error"
]
EffectDocument = Annotated[
    ClearanceTiltEffect | BacklashEffect | BacklashLoadEffect | AxialComplianceEffect | RadialComplianceEffect |
    EccentricityEffect | SecondHarmonicEffect | GearErrorEffect | EncoderScaleEffect | JointCouplingEffect |
    GravitySpringEffect | LinkBendingEffect | LinkTorsionEffect | BaseComplianceEffect | ThermalGrowthEffect |
    PayloadErrorEffect | FrictionWindupEffect | TimeOffsetEffect | TrackingLagEffect | DriftEffect |
    MeasurementScaleEffect | SessionShiftEffect | ZeroDriftEffect | ZeroThermalEffect | LinkGrowthEffect |
    SettlingEffect | RandomWalkEffect | BaseStepEffect | ToolStepEffect | ZeroStepEffect | ColumnBendingEffect |
    ThermalDriftEffect | MeasuredTiltEffect | ToolSagEffect | HardeningEffect | DirectionComplianceEffect |
    ReadingTiltEffect | StraightnessEffect | GuideRotationEffect | TelescopeBendingEffect | UnknownSmoothCurveEffect
    | UnknownJointCurveEffect | UnknownFieldEffect | UnknownResidualEffect | LoadErrorEffect,
    Field(discriminator="id"),
]
# fmt: on


def _form(given: object) -> str:
    """Whether an effect is told by its id alone or as an object."""
    return "id" if isinstance(given, str) else "effect"


# An effect by its id alone, with all it can act on, or as an object with its options.
AnyEffect = Annotated[Annotated[EffectName, Tag("id")] | Annotated[EffectDocument, Tag("effect")], Discriminator(_form)]
