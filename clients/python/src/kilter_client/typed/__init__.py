"""Types of the answers of the server; all modules but this one are made from the interface by `make contract`.

A module is imported when it is first asked for, as in ``typed.robots.RobotReport``: most commands need none of them.
"""

from __future__ import annotations

from kilter_files.ground.later import later

with later(__name__):
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
