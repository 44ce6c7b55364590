"""Types of the answers of the server; all modules but this one are made from the interface by `make contract`.

A module is imported when it is first asked for, as in ``typed.robots.RobotReport``: most commands need none of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__all__ = [
    "acceptance",
    "budgets",
    "cameras",
    "campaigns",
    "checks",
    "comparisons",
    "drifts",
    "effect_curves",
    "evaluations",
    "fits",
    "fleet_priors",
    "identifications",
    "jobs",
    "kinematics",
    "names",
    "options",
    "others",
    "plans",
    "previews",
    "robots",
    "search_numbers",
    "searches",
    "server",
    "versions",
]

if TYPE_CHECKING:
    from kilter_client.typed import (
        acceptance,
        budgets,
        cameras,
        campaigns,
        checks,
        comparisons,
        drifts,
        effect_curves,
        evaluations,
        fits,
        fleet_priors,
        identifications,
        jobs,
        kinematics,
        names,
        options,
        others,
        plans,
        previews,
        robots,
        search_numbers,
        searches,
        server,
        versions,
    )
else:

    def __getattr__(name: str) -> Any:
        """Import the module of this name."""
        try:
            return import_module(f"{__name__}.{name}")
        except ModuleNotFoundError:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
