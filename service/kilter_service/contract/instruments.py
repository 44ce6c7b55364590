"""Instruments: what they are, how wrong they may be, and the certificate that says so."""

from __future__ import annotations

from datetime import date, datetime
from typing import Annotated, Literal

from pydantic import Field, model_validator

from kilter_service.contract.units import Listed, Micrometres, MicrometresPerMetre, Name, Strict

InstrumentKind = Literal["laser_tracker", "arm_cmm", "cmm", "camera", "ball_bar", "other"]
MpeStandard = Literal["iso_10360_10", "iso_10360_12", "other"]
Text = Annotated[str, Field(max_length=200)]
OF_KIND: dict[str, InstrumentKind] = {"iso_10360_10": "laser_tracker", "iso_10360_12": "arm_cmm"}
LARGEST_MPE_UM, LARGEST_MPE_UM_PER_M = 100_000.0, 10_000.0


class NewInstrument(Strict):
    """An instrument as one certificate describes it: with the next certificate it is added under another name.

    Its maximum permissible error for a length L is ``mpe_um + mpe_um_per_m * L``, L in metres.
    """

    name: Name = Field(
        description="Name of the instrument with this certificate, unique on the server: letters, digits, `_`, `.` and `-`."
    )
    kind: InstrumentKind = Field(description="What it is; `arm_cmm`: an articulated arm with a probe.")
    serial_number: Annotated[Text, Field(min_length=1)] = Field(description="Serial number, as on its plate.")
    mpe_standard: MpeStandard = Field(
        "other",
        description="What states its permissible error: ISO 10360-10 (laser trackers), ISO 10360-12 (articulated arms), or "
        "other, for instance its maker.",
    )
    mpe_um: Annotated[Micrometres, Field(ge=0, le=LARGEST_MPE_UM)] = Field(
        description="Maximum permissible error at length 0, micrometres: A of A + B L."
    )
    mpe_um_per_m: Annotated[MicrometresPerMetre, Field(ge=0, le=LARGEST_MPE_UM_PER_M)] = Field(
        0.0, description="What it grows by per length, micrometres per metre: B of A + B L."
    )
    certificate: Text = Field("", description="Number of its calibration certificate; empty: none.")
    certified_on: date | None = Field(None, description="Day of the certificate; null: not stated.")
    valid_until: date | None = Field(None, description="Last day on which it holds; null: not stated.")
    notes: Annotated[str, Field(max_length=20_000)] = Field("", description="Whatever else is worth knowing.")

    @model_validator(mode="after")
    def _fits_together(self) -> NewInstrument:
        if self.mpe_um == 0.0 and self.mpe_um_per_m == 0.0:
            raise ValueError("no instrument is without error: give mpe_um, mpe_um_per_m or both")
        if self.certified_on and self.valid_until and self.valid_until < self.certified_on:
            raise ValueError("valid_until is before certified_on")
        if OF_KIND.get(self.mpe_standard, self.kind) != self.kind:
            raise ValueError(
                f"mpe_standard {self.mpe_standard} is of kind {OF_KIND[self.mpe_standard]}, not {self.kind}: give `other`"
            )
        return self


class Instrument(NewInstrument):
    """A stored instrument."""

    created_at: datetime = Field(description="When it was added.")


class InstrumentList(Listed):
    """All instruments, by name."""

    instruments: list[Instrument] = Field(description="Instruments, by name.")
