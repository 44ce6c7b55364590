"""Types of the answers of the server, made from the interface when the client is installed or built.

A module is imported when it is first asked for, as in ``typed.robots.RobotReport``: most commands need none of them.
"""

from __future__ import annotations

from pathlib import Path

from kilter_files.ground.later import later

if not Path(__file__).with_name("names.py").exists():
    raise ImportError("The types of answers are not made yet in this checkout of Kilter: run `make setup`.")

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
