"""Every effect Kilter knows, by id. Adding one is its file, one line here, and one row in the docs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from core.effects.axial_compliance import AxialCompliance
from core.effects.backlash import Backlash
from core.effects.backlash_load import BacklashLoad
from core.effects.base import Effect
from core.effects.base_compliance import BaseCompliance
from core.effects.clearance_tilt import ClearanceTilt
from core.effects.column_bending import ColumnBending
from core.effects.direction_compliance import DirectionCompliance
from core.effects.drift import Drift
from core.effects.eccentricity import Eccentricity
from core.effects.encoder_scale import EncoderScale
from core.effects.friction_windup import FrictionWindup
from core.effects.gear_error import GearError
from core.effects.gravity_spring import GravitySpring
from core.effects.hardening import Hardening
from core.effects.joint_coupling import JointCoupling
from core.effects.link_bending import LinkBending
from core.effects.link_growth import LinkGrowth
from core.effects.load_error import LoadError
from core.effects.measurement_scale import MeasurementScale
from core.effects.payload_error import PayloadError
from core.effects.radial_compliance import RadialCompliance
from core.effects.random_walk import RandomWalk
from core.effects.reading_tilt import ReadingTilt
from core.effects.second_harmonic import SecondHarmonic
from core.effects.session_shift import SessionShift
from core.effects.settling import Settling
from core.effects.thermal_drift import ThermalDrift
from core.effects.thermal_growth import ThermalGrowth
from core.effects.time_offset import TimeOffset
from core.effects.tool_sag import ToolSag
from core.effects.tracking_lag import TrackingLag
from core.effects.unknown_field import UnknownField
from core.effects.unknown_joint_curve import UnknownJointCurve
from core.effects.unknown_residual import UnknownResidual
from core.effects.unknown_smooth_curve import UnknownSmoothCurve
from core.effects.zero_drift import ZeroDrift
from core.effects.zero_thermal import ZeroThermal
from core.errors import OptionError

_ALL: tuple[type[Effect], ...] = (
    ClearanceTilt,
    Backlash,
    BacklashLoad,
    AxialCompliance,
    RadialCompliance,
    Eccentricity,
    SecondHarmonic,
    GearError,
    EncoderScale,
    JointCoupling,
    GravitySpring,
    LinkBending,
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
    Settling,
    RandomWalk,
    ColumnBending,
    ThermalDrift,
    ToolSag,
    Hardening,
    DirectionCompliance,
    ReadingTilt,
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
    return _class_of(effect_id).made(joints=chosen, **config)


def effect_from_document(document: Mapping[str, Any]) -> Effect:
    """Make an effect from its document (joints count from 1).

    Raises:
        OptionError: no such effect, or an option it does not have.

    """
    return _class_of(str(document.get("id"))).from_document(document)


def _class_of(effect_id: str) -> type[Effect]:
    known = EFFECTS.get(effect_id)
    if known is None:
        raise OptionError(f"There is no effect {effect_id!r}. There are: {', '.join(EFFECTS)}.", effect=effect_id)
    return known
