"""Versions and activations as they go over the wire."""

from __future__ import annotations

import math
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

READ_OUT = ("effects", "metrics")  # of a summary, what no field of the record holds
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
        parameters=as_written(list[Parameter], [_with_change(row) for row in report.get("parameters") or []]),
        null_directions=as_written(list[NullDirection], report.get("null_directions") or []),
        noise_mm=report.get("noise_mm"),
        warnings=as_written(list[Remark], report.get("warnings") or []),
        objections=objections_of(report, limits),
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
    return VersionSummary(**_told(record))


def _told(record: VersionRecord) -> dict[str, Any]:
    """What a list tells: the record's own fields, and what is read out of its documents."""
    own = {name: getattr(record, name) for name in VersionSummary.model_fields if name not in READ_OUT}
    effects = [effect["id"] for effect in record.calibration["effects"]]
    return own | {"effects": effects, "metrics": as_written(Metrics, record.report.get("metrics") or {})}


def activation(record: ActivationRecord) -> Activation:
    """Say what an entry of the log tells."""
    own = {name: getattr(record, name) for name in Activation.model_fields if name != "objections"}
    return Activation(**own, objections=as_written(list[Objection], record.objections))
