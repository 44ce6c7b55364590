"""What a version leaves of every row, as columns."""

from __future__ import annotations

from pydantic import Field

from kilter_service.contract.units import Deg, Mm, Strict

Lengths = list[Mm | None]


class ResidualRows(Strict):
    """What a version leaves of rows, measured minus predicted, as columns; every one has a value for each row."""

    campaign: list[str] = Field(description="Id of the row's campaign.")
    row: list[int] = Field(description="Number of the row in its campaign, from 1.")
    dx_mm: Lengths = Field(description="Error along x, mm, the mean of the markers; null: nothing was seen.")
    dy_mm: Lengths = Field(description="Error along y, mm.")
    dz_mm: Lengths = Field(description="Error along z, mm.")
    turn_deg: list[Deg | None] = Field(description="Error of the orientation, degrees; null: it was not measured.")
    residual_sigma: list[float | None] = Field(
        description="Length of what is left in standard deviations of a coordinate; rotations count too."
    )
    u95_x_mm: Lengths = Field(description="Half width of the 95 % interval that expects the error along x, mm.")
    u95_y_mm: Lengths = Field(description="Half width of the 95 % interval along y, mm.")
    u95_z_mm: Lengths = Field(description="Half width of the 95 % interval along z, mm.")
    set_aside: list[bool] = Field(description="Whether the identification set the row aside.")
    held_out: list[bool] = Field(description="Whether the row was held out of the fit.")
