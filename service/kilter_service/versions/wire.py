"""Versions and activations as they go over the wire."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from kilter_core.types import Floats
from kilter_files.ground.later import pa
from kilter_service.contract.fits import Covariance, Metrics, NullDirection, Parameter
from kilter_service.contract.versions import (
    Activation,
    CorrectionLimits,
    Details,
    JointPreview,
    Objection,
    Rival,
    UsedCampaign,
    Version,
    VersionPreview,
    VersionSummary,
)
from kilter_service.contract.wording import Remark, as_written
from kilter_service.ground import correction_limits
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.wire import joint_scale, joint_units, to_deg, to_metres, to_mm, to_rad
from kilter_service.versions.objections import objections_from_report
from kilter_service.versions.records import ActivationRecord, PreviewedPoses, VersionRecord
from kilter_service.versions.store import TORQUES

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.identify import Difference


OF_ITS_OWN = ("parameters", "null_directions", "noise_mm", "warnings", "metrics")  # parts of a report with fields


def version(record: VersionRecord) -> Version:
    """Say all a version holds."""
    report, limits = record.report, CorrectionLimits(**record.limits)
    return copy_fields(
        Version,
        record,
        **_read_out(record),
        campaigns=as_written(list[UsedCampaign], record.campaigns),
        limits=limits,
        parameters=as_written(list[Parameter], [_with_change(row) for row in report.get("parameters") or []]),
        null_directions=as_written(list[NullDirection], report.get("null_directions") or []),
        noise_mm=report.get("noise_mm"),
        warnings=as_written(list[Remark], report.get("warnings") or []),
        objections=objections_from_report(report, limits),
        details=as_written(Details, {key: value for key, value in report.items() if key not in OF_ITS_OWN}),
        covariance=as_written(Covariance, record.covariance),
    )


def _with_change(row: dict[str, Any]) -> dict[str, Any]:
    """Say the change of a parameter that was stored without it."""
    value, nominal = row.get("value"), row.get("nominal")
    if "change" in row or value is None or nominal is None:
        return row
    change = value - nominal
    frame, _, axis = str(row.get("name")).partition("_")
    turns = frame in ("base", "tool") and axis in ("rx", "ry", "rz")
    return {**row, "change": math.remainder(change, 360.0) if turns else change}


def summary(record: VersionRecord) -> VersionSummary:
    """Say what lists tell of a version."""
    return copy_fields(VersionSummary, record, **_read_out(record))


def _read_out(record: VersionRecord) -> dict[str, Any]:
    """What a list tells that no field of the record holds."""
    effects = [effect["id"] for effect in record.calibration["effects"]]
    metrics = as_written(Metrics, record.report.get("metrics") or {})
    return {"effects": effects, "metrics": metrics, "torques": TORQUES in record.calibration}


def activation(record: ActivationRecord) -> Activation:
    """Say what an entry of the log tells."""
    return copy_fields(Activation, record, objections=as_written(list[Objection], record.objections))


def rival(difference: Difference, errors: Floats) -> Rival:
    """Say how a version compares with another, whose ``errors (P,)`` m by pose are given."""
    return Rival(
        poses=len(errors),
        mean_mm=to_mm(float(errors.mean())),
        larger_by_mm=to_mm(difference.mean),
        margin_mm=to_mm(difference.margin),
    )


def preview(
    version_id: str,
    robot: Robot,
    found: PreviewedPoses,
    within: Literal["campaigns", "limits"],
    temperature_c: float | None,
) -> VersionPreview:
    """Say how a version would correct."""
    scale, units, counts = joint_scale(robot), joint_units(robot), found.counts
    shown = [_joints(found.q, place, scale) for place in found.by_joint]
    sizes = [None if at is None else float(abs(found.delta[at, k])) * scale[k] for k, at in enumerate(found.by_joint)]
    return VersionPreview(
        version_id=version_id,
        within=within,
        poses=len(found.q),
        corrected=found.corrected_count,
        damped=counts.get("DAMPED", 0),
        limited=counts.get("LIMITED", 0),
        refused=found.refusal_counts,
        mean_mm=to_mm(float(np.nanmean(found.moved))) if found.corrected_count else None,
        largest_mm=None if found.furthest is None else to_mm(float(found.moved[found.furthest])),
        largest_at=_joints(found.q, found.furthest, scale),
        left_mm=None if found.worst is None else to_mm(float(found.left[found.worst])),
        left_at=_joints(found.q, found.worst, scale),
        joints=[
            JointPreview(
                joint=joint.name,
                largest_deg=size if unit == "deg" else None,
                largest_mm=size if unit == "mm" else None,
                largest_at=at,
            )
            for joint, unit, size, at in zip(robot.joints, units, sizes, shown, strict=True)
        ],
        **correction_limits.fields(found.unsupported, found.where_stated),
        temperature_c=temperature_c,
    )


def _joints(q: Floats, place: int | None, scale: Sequence[float]) -> list[float] | None:
    """A pose in degrees and mm."""
    return None if place is None else [round(float(v) * k, 4) for v, k in zip(q[place], scale, strict=True)]


def noise_from_report(report: dict[str, Any]) -> tuple[float, float]:
    """Read what a stored report says of the scatter of a point (m) and of a rotation (rad); nan where it says nothing."""
    scale = report.get("scale") or {"point_mm": report.get("noise_mm") or float("nan"), "turn_deg": float("nan")}
    return to_metres(float(scale["point_mm"])), to_rad(float(scale["turn_deg"]))


def residual_columns(error: Floats, u95: Floats, turn: Floats, size: Floats) -> dict[str, Any]:
    """Say what is left of rows: errors and half intervals (N, 3) m, rotations (N,) rad, and their length (N,) in sigma."""
    columns = {f"d{axis}_mm": to_mm(error[:, k]) for k, axis in enumerate("xyz")}
    columns |= {"turn_deg": to_deg(turn), "residual_sigma": size}
    columns |= {f"u95_{axis}_mm": to_mm(u95[:, k]) for k, axis in enumerate("xyz")}
    return {name: pa.array(values, pa.float64(), mask=np.isnan(values)) for name, values in columns.items()}
