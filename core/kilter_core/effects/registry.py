"""Every effect Kilter knows, by id. Adding one is its file, one line here, and one row in the docs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from kilter_core.effects.axial_compliance import AxialCompliance
from kilter_core.effects.backlash import Backlash
from kilter_core.effects.backlash_load import BacklashLoad
from kilter_core.effects.base import Effect
from kilter_core.effects.base_compliance import BaseCompliance
from kilter_core.effects.base_step import BaseStep
from kilter_core.effects.clearance_tilt import ClearanceTilt
from kilter_core.effects.column_bending import ColumnBending
from kilter_core.effects.direction_compliance import DirectionCompliance
from kilter_core.effects.drift import Drift
from kilter_core.effects.eccentricity import Eccentricity
from kilter_core.effects.encoder_curve import EncoderCurve
from kilter_core.effects.encoder_scale import EncoderScale
from kilter_core.effects.friction_windup import FrictionWindup
from kilter_core.effects.gear_error import GearError
from kilter_core.effects.gravity_spring import GravitySpring
from kilter_core.effects.guide_rotation import GuideRotation
from kilter_core.effects.hardening import Hardening
from kilter_core.effects.joint_coupling import JointCoupling
from kilter_core.effects.link_bending import LinkBending
from kilter_core.effects.link_growth import LinkGrowth
from kilter_core.effects.link_lengthening import LinkLengthening
from kilter_core.effects.link_torsion import LinkTorsion
from kilter_core.effects.load_error import LoadError
from kilter_core.effects.local_bump import LocalBump
from kilter_core.effects.measured_tilt import MeasuredTilt
from kilter_core.effects.measurement_scale import MeasurementScale
from kilter_core.effects.payload_error import PayloadError
from kilter_core.effects.radial_compliance import RadialCompliance
from kilter_core.effects.random_walk import RandomWalk
from kilter_core.effects.reading_tilt import ReadingTilt
from kilter_core.effects.scale_thermal import ScaleThermal
from kilter_core.effects.second_harmonic import SecondHarmonic
from kilter_core.effects.session_shift import SessionShift
from kilter_core.effects.settling import Settling
from kilter_core.effects.straightness import Straightness
from kilter_core.effects.strain_wave import StrainWave
from kilter_core.effects.telescope_bending import TelescopeBending
from kilter_core.effects.thermal_drift import ThermalDrift
from kilter_core.effects.thermal_growth import ThermalGrowth
from kilter_core.effects.time_offset import TimeOffset
from kilter_core.effects.tool_sag import ToolSag
from kilter_core.effects.tool_step import ToolStep
from kilter_core.effects.tracking_lag import TrackingLag
from kilter_core.effects.unknown_field import UnknownField
from kilter_core.effects.unknown_joint_curve import UnknownJointCurve
from kilter_core.effects.unknown_residual import UnknownResidual
from kilter_core.effects.unknown_smooth_curve import UnknownSmoothCurve
from kilter_core.effects.zero_drift import ZeroDrift
from kilter_core.effects.zero_step import ZeroStep
from kilter_core.effects.zero_thermal import ZeroThermal
from kilter_core.errors import OptionError

_ALL: tuple[type[Effect], ...] = (
    ClearanceTilt,
    Backlash,
    BacklashLoad,
    AxialCompliance,
    RadialCompliance,
    Eccentricity,
    SecondHarmonic,
    GearError,
    EncoderCurve,
    LocalBump,
    EncoderScale,
    JointCoupling,
    GravitySpring,
    LinkBending,
    LinkTorsion,
    BaseCompliance,
    ThermalGrowth,
    PayloadError,
    FrictionWindup,
    TimeOffset,
    TrackingLag,
    Drift,
    MeasurementScale,
    SessionShift,
    ZeroDrift,
    ZeroThermal,
    LinkGrowth,
    LinkLengthening,
    Settling,
    RandomWalk,
    BaseStep,
    ToolStep,
    ZeroStep,
    ColumnBending,
    ThermalDrift,
    ScaleThermal,
    MeasuredTilt,
    ToolSag,
    Hardening,
    StrainWave,
    DirectionCompliance,
    ReadingTilt,
    Straightness,
    GuideRotation,
    TelescopeBending,
    UnknownSmoothCurve,
    UnknownJointCurve,
    UnknownField,
    UnknownResidual,
    LoadError,
)

EFFECTS: Mapping[str, type[Effect]] = MappingProxyType({effect.id: effect for effect in _ALL})


def make_effect(effect_id: str, joints: Iterable[int] | None = None, **config: Any) -> Effect:
    """Make an effect by id; ``joints`` count from 0, None means all.

    Raises:
        OptionError: no such effect, or an option it does not have.

    """
    chosen = None if joints is None else tuple(int(j) for j in joints)
    return _effect_class(effect_id).from_options(joints=chosen, **config)


def effect_from_document(document: Mapping[str, Any]) -> Effect:
    """Make an effect from its document (joints count from 1).

    Raises:
        OptionError: no such effect, or an option it does not have.

    """
    return _effect_class(str(document.get("id"))).from_document(document)


def _effect_class(effect_id: str) -> type[Effect]:
    known = EFFECTS.get(effect_id)
    if known is None:
        raise OptionError(f"There is no effect {effect_id!r}. There are: {', '.join(EFFECTS)}.", effect=effect_id)
    return known
