"""How far the tool of an arm can be from its base, and what an arm of that size may carry."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from kilter_core.arm import Robot

# Of public data sheets no arm carries more than it weighs, or more than 50 kg per m3 of its reach's cube; the smallest
# SCARAs carry some kg at 0.2 m. Lengths of the links add up to more than the reach of a data sheet.
PER_REACH_KG, LEAST_KG = 50.0, 10.0
# A description may state masses for some links only, or numbers that fill a field.
PER_REACH_BESIDE_MASSES_KG, LEAST_BESIDE_MASSES_KG = 15.0, 1.0


def heaviest_likely_payload(robot: Robot) -> tuple[float, str]:
    """Return the largest payload (kg) that an arm of this mass, else of this reach, may carry, and what that rests on."""
    mass, reach = sum(link.mass for link in robot.links), longest_reach(robot)
    if mass > 0:
        by_reach = PER_REACH_BESIDE_MASSES_KG * reach**3 + LEAST_BESIDE_MASSES_KG
        return max(mass, by_reach), f"the links of the arm weigh {mass:.3g} kg"
    return PER_REACH_KG * reach**3 + LEAST_KG, f"the arm reaches {reach:.2g} m at most"


def longest_reach(robot: Robot) -> float:
    """Return the sum of all lengths and strokes of the arm and its tool (m): no point of the workspace is farther out."""
    lengths = sum(abs(e.value) for e in robot.chain.elements if not e.axis.rotates)
    strokes = [max(abs(j.lower), abs(j.upper)) for j in robot.joints if j.kind == "prismatic"]
    return float(lengths + sum(strokes) + np.linalg.norm(robot.T_tool[:3, 3]))
