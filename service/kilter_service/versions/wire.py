"""Versions and activations as they go over the wire."""

from __future__ import annotations

from typing import Any

from kilter_service.contract.fits import Covariance, Metrics, NullDirection, Parameter, Remark
from kilter_service.contract.versions import (
    Activation,
    CorrectionLimits,
    Details,
    Objection,
    UsedCampaign,
    Version,
    VersionSummary,
)
from kilter_service.contract.written import as_written
from kilter_service.versions.objections import objections_of
from kilter_service.versions.records import ActivationRecord, VersionRecord

OF_ITS_OWN = ("parameters", "null_directions", "noise_mm", "warnings", "metrics")  # parts of a report with fields


def version(record: VersionRecord) -> Version:
    """Say all a version holds."""
    report, limits = record.report, CorrectionLimits(**record.limits)
    return Version(
        **_told(record),
        sha256=record.sha256,
        hash_scheme=record.hash_scheme,
        robot_sha256=record.robot_sha256,
        campaigns=as_written(list[UsedCampaign], record.campaigns),
        limits=limits,
        parameters=as_written(list[Parameter], report.get("parameters") or []),
        null_directions=as_written(list[NullDirection], report.get("null_directions") or []),
        noise_mm=report.get("noise_mm"),
        warnings=as_written(list[Remark], report.get("warnings") or []),
        objections=objections_of(report, limits),
        details=as_written(Details, {key: value for key, value in report.items() if key not in OF_ITS_OWN}),
        covariance=as_written(Covariance, record.covariance),
    )


def summary(record: VersionRecord) -> VersionSummary:
    """Say what lists tell of a version."""
    return VersionSummary(**_told(record))


def _told(record: VersionRecord) -> dict[str, Any]:
    return {
        "id": record.id,
        "robot": record.robot,
        "active": record.active,
        "parent_id": record.parent_id,
        "job_id": record.job_id,
        "created_at": record.created_at,
        "code_version": record.code_version,
        "effects": [effect["id"] for effect in record.calibration["effects"]],
        "metrics": as_written(Metrics, record.report.get("metrics") or {}),
        "name": record.name,
        "notes": record.notes,
        "retired_at": record.retired_at,
    }


def activation(record: ActivationRecord) -> Activation:
    """Say what an entry of the log tells."""
    return Activation(
        version_id=record.version_id,
        action=record.action,
        actor=record.actor,
        at=record.at,
        forced=record.forced,
        reason=record.reason,
        objections=as_written(list[Objection], record.objections),
    )
