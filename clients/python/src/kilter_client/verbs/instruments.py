"""Verbs about instruments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from kilter_client import typed
from kilter_client.requests.calls import campaigns
from kilter_client.requests.steps import Steps
from kilter_client.results.record import Records
from kilter_client.verbs.inputs import parse_day

if TYPE_CHECKING:
    from datetime import date


Kind = Literal["laser_tracker", "arm_cmm", "cmm", "camera", "ball_bar", "other"]
Standard = Literal["iso_10360_10", "iso_10360_12", "other"]


def add_instrument(
    name: str,
    kind: Kind,
    serial_number: str,
    *,
    mpe_um: float,
    mpe_um_per_m: float = 0.0,
    mpe_standard: Standard = "other",
    certificate: str = "",
    certified_on: date | str | None = None,
    valid_until: date | str | None = None,
    notes: str = "",
) -> Steps[typed.campaigns.Instrument]:
    """Add an instrument with its maximum permissible error and its certificate; the same one twice changes nothing.

    With its next certificate it is added under another name: what was measured before keeps the certificate of then.

    Args:
        name: name to give it, as ``"tracker-2026"``.
        kind: ``"laser_tracker"``, ``"arm_cmm"`` (an articulated arm), ``"cmm"``, ``"camera"``, ``"ball_bar"`` or ``"other"``.
        serial_number: as on its plate.
        mpe_um: permissible error at length 0, micrometres: A of A + B L.
        mpe_um_per_m: what it grows by per length, micrometres per metre: B of A + B L.
        mpe_standard: what states it: ``"iso_10360_10"`` (trackers), ``"iso_10360_12"`` (articulated arms) or ``"other"``.
        certificate: number of the calibration certificate.
        certified_on: day of the certificate, as ``"2026-01-10"``.
        valid_until: last day on which it holds.
        notes: anything else worth knowing.

    Raises:
        UsageError: a day that is none; ConflictError: another instrument has that name.

    """
    wanted = {
        "name": name,
        "kind": kind,
        "serial_number": serial_number,
        "mpe_standard": mpe_standard,
        "mpe_um": mpe_um,
        "mpe_um_per_m": mpe_um_per_m,
        "certificate": certificate,
        "certified_on": parse_day(certified_on),
        "valid_until": parse_day(valid_until),
        "notes": notes,
    }
    return typed.campaigns.Instrument.read((yield from campaigns.add_instrument(wanted)))


def instruments() -> Steps[Records[typed.campaigns.Instrument]]:
    """Return the instruments by name, with permissible errors in um and um/m, and their certificates."""
    return Records(
        typed.campaigns.Instrument,
        [typed.campaigns.Instrument.read(one) for one in (yield from campaigns.list_instruments())],
    )
