"""The methods of identification by name: what is to be known of each before it runs, and where it stands.

The options check themselves against these records, and the methods read the options: so a record names its function, and
imports it when it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class Method:
    """A way to fit.

    ``where`` is ``module:function`` below ``kilter_core.identify``, a function of the start, the measurement, the
    options and who hears of progress, that returns a ``Fit``. ``summary`` is its line in `kilter server methods`.
    ``minimum`` says that it ends at a least-squares minimum, which intervals rest on; ``lets_rows_go`` that it goes
    with loss "tukey"; ``continues`` that it takes what is known beforehand, and goes on from it;
    ``weighs_by_influence`` that it needs the influence of every row. ``again`` fits the same rows anew where a start
    near the minimum is known; empty: the method itself, from its start.
    """

    where: str
    summary: str
    minimum: bool = False
    lets_rows_go: bool = False
    continues: bool = False
    weighs_by_influence: bool = False
    again: str = ""

    def fitter(self) -> Callable[..., Any]:
        """The function that fits."""
        module, _, name = self.where.partition(":")
        fitter: Callable[..., Any] = getattr(import_module(f"kilter_core.identify.{module}"), name)
        return fitter


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "least_squares": Method(
            "estimate:estimate",
            "all poses together, weighted, with the exact Jacobian; take it first",
            minimum=True,
            lets_rows_go=True,
            again="least_squares",
        ),
        "pose_pseudo_inverse": Method(
            "methods.per_pose:pose_pseudo_inverse", "pose by pose, and the mean of the answers (thesis 3.6)"
        ),
        "influence": Method(
            "methods.per_pose:influence",
            "pose by pose, each weighted by its influence (thesis 3.7, 3.8)",
            weighs_by_influence=True,
        ),
        "kalman": Method(
            "methods.kalman:kalman",
            "continue a version with the rows of a new campaign alone",
            minimum=True,
            continues=True,
        ),
        "global_search": Method(
            "methods.global_search:global_search",
            "search a box first: zeros off by a turn, another description",
            minimum=True,
            lets_rows_go=True,
            again="least_squares",
        ),
        "linear_least_squares": Method(
            "methods.linear:linear_least_squares", "the problem linearised at the start, solved once"
        ),
    }
)
