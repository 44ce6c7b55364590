"""Laws of temperature: from which temperature they count, and whether a correction makes up for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, option
from kilter_core.effects.batch import Batch
from kilter_core.types import Floats


@dataclass(frozen=True)
class LawOfTemperature(Effect):
    """Something moves in proportion to T − T0; ``reference_c`` is T0, at which the geometry holds.

    Any T0 will do as long as all campaigns use the same one.
    """

    needs = frozenset({"temperature_c"})
    clock = "temperature_c"

    reference_c: float = option(20.0, "Temperature T0 at which the geometry holds, degrees Celsius.", above=-273.15)
    corrected: bool = option(
        True, "Whether a correction makes up for it; false where the base, the station or the air may be what moves."
    )

    def warmer(self, batch: Batch) -> Floats:
        """Return T − T0 (N,) K of the rows."""
        return np.asarray(self.column(batch, "temperature_c"), dtype=np.float64) - self.reference_c

    def warmer_now(self, form: RunTimeForm) -> float | None:
        """Return T − T0 in K of a moving arm; None where its temperature is not stated or this is not corrected."""
        return form.warmer_than(self.reference_c) if self.corrected else None
