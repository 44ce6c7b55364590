"""Certificates of instruments: whether one held on the day of a campaign, and the error that it permits."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any

from kilter_service.contract.instruments import Instrument
from kilter_service.contract.remarks import Remark
from kilter_service.ground.core import core_evaluate
from kilter_service.ground.wire import from_um

if TYPE_CHECKING:
    from kilter_service.contract.instruments import Instrument


def remarks(instrument: Instrument | None, measured_at: datetime | None, stored_at: datetime) -> list[Remark]:
    """Say what a certificate has against a campaign; where nobody stated when it was measured, the day it was stored counts."""
    if instrument is None:
        return []
    day = (measured_at or stored_at).date()
    when = f"the campaign was measured on {day}" if measured_at else f"the campaign was stored on {day}"
    name, until, since = instrument.name, instrument.valid_until, instrument.certified_on
    if until is not None and day > until:
        message = (
            f"The certificate of instrument {name} held until {until}, and {when}: its permissible error is not shown for that "
            "day. Have it calibrated, add it with the new certificate under another name, and measure again."
        )
        return [Remark(code="instrument_expired", message=message)]
    if since is not None and day < since:
        message = (
            f"The certificate of instrument {name} is of {since}, and {when}, before it: name the instrument with the "
            "certificate that held then."
        )
        return [Remark(code="instrument_not_yet_certified", message=message)]
    return []


def permissible(instrument: Instrument | None) -> Any:
    """Return an instrument's permissible error as core has it; None without one."""
    if instrument is None:
        return None
    return core_evaluate.PermissibleError(from_um(instrument.mpe_um), from_um(instrument.mpe_um_per_m))
