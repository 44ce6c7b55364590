"""Every effect Kilter knows, by id. Adding one is its class, one line here, and one row in the docs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from kilter_core.effects.backlash import Backlash, BacklashLoad, ClearanceTilt, FrictionWindup, GearError
from kilter_core.effects.base import Effect
from kilter_core.effects.compliance import (
    AxialCompliance,
    BaseCompliance,
    DirectionCompliance,
    GravitySpring,
    Hardening,
    RadialCompliance,
    StrainWave,
)
from kilter_core.effects.curves import GuideRotation, Straightness
from kilter_core.effects.instrument import MeasuredTilt, MeasurementScale, TimeOffset, TrackingLag
from kilter_core.effects.links import LinkBending, LinkTorsion, TelescopeBending, ToolSag
from kilter_core.effects.masses import LoadError, PayloadError
from kilter_core.effects.over_time import Drift, LinkLengthening, RandomWalk, Settling, ZeroDrift
from kilter_core.effects.readings import (
    Eccentricity,
    EncoderCurve,
    EncoderScale,
    JointCoupling,
    LocalBump,
    ReadingTilt,
    SecondHarmonic,
)
from kilter_core.effects.steps import BaseStep, SessionShift, ToolStep, ZeroStep
from kilter_core.effects.thermal import (
    ColumnBending,
    LinkGrowth,
    ScaleThermal,
    ThermalDrift,
    ThermalGrowth,
    ZeroThermal,
)
from kilter_core.effects.unknown import UnknownField, UnknownJointCurve, UnknownResidual, UnknownSmoothCurve
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
