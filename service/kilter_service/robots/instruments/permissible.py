"""The permissible error of an instrument, as core has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kilter_service.ground.core import core_evaluate
from kilter_service.ground.wire import from_um

if TYPE_CHECKING:
    from kilter_service.contract.instruments import Instrument


def permissible(instrument: Instrument | None) -> Any:
    """Return an instrument's permissible error as core has it; None without one."""
    if instrument is None:
        return None
    return core_evaluate.PermissibleError(from_um(instrument.mpe_um), from_um(instrument.mpe_um_per_m))
