"""Sums of parameters that data know where they do not tell the members."""

from __future__ import annotations

from pydantic import Field

from kilter_service.contract.units import Stored


class Term(Stored):
    """A parameter's part in a sum."""

    name: str = Field(description="Name of the parameter.")
    coefficient: float = Field(description="What it is multiplied by, each in its own unit.")


class IdentifiableSum(Stored):
    """A sum of parameters that the data know where they do not tell its members."""

    parameters: list[Term] = Field(description="Its terms.")
    value: float = Field(description="Value of the sum.")
    unit: str = Field(description="Unit of the numbers: that of the first parameter.")
    sigma: float = Field(description="Standard deviation.")
    lower: float = Field(description="Lower end of the 95 % interval.")
    upper: float = Field(description="Upper end of the 95 % interval.")
    sentence: str = Field(description="The same in words.")
