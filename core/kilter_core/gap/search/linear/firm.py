"""A problem's inner products with the loads held at their values, made where a comparison asks for them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from kilter_core.gap.search.linear.derivatives import Derivatives
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.linear.less_geometry import less_geometry
from kilter_core.gap.search.linear.projection import Projection
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.types import Floats


@dataclass(frozen=True)
class Firm:
    """Columns of a problem whose load errors are geometry that does not move; what a type tells may.

    It has the derivatives and not the problem, whose inner products refer to it: that circle kept problems of thousands of
    poses, 100 MB each, until the interpreter looked for circles.
    """

    settings: ProblemSettings
    values: Floats
    derivatives: Derivatives
    raw: Floats
    size: Floats
    nu: float
    directions: int

    def gram(self) -> Gram:
        """Return the inner products."""
        return self._gram_with_held_loads

    @cached_property
    def _gram_with_held_loads(self) -> Gram:
        source = self.settings.source
        y = self.raw + self.derivatives.W @ (source.library(self.values) * self.size)
        told = source.soft & ~source.of_loads
        soft, U, y = less_geometry(self.settings, self.values, self.derivatives.G, y, told)
        products = Projection.from_columns(soft, U, self.derivatives.W).products(y)
        return Gram(*products, float(y @ y), self.nu + self.directions - U.shape[1])
