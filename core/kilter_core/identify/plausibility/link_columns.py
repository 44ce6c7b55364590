"""Whether two encoders of each joint belong together: order, sign and unit of link-side columns against the motor's."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import ObservationError
from kilter_core.identify.plausibility.plausibility import FACTOR, FOREIGN
from kilter_core.observations import Observations
from kilter_core.parameters import DEG, degrees
from kilter_core.types import Floats

NEAR_RAD = np.radians(2.0)  # scatter between the encoders of a joint that is not looked at further
ROWS = 500
FEWEST_VALUES = 3
UNITS = ((1.0, ""), (DEG, "radians declared as degrees"), (np.pi / 180.0, "degrees declared as radians"))


def refuse_foreign_links(robot: Robot, rows: Observations) -> None:
    """Look for link-side columns that are another joint's, of the other sign or in the other unit.

    Raises:
        ObservationError: ``foreign_observations``, with joint, what it looks like, how much that explains, and the remedy.

    """
    if rows.link_q is None:
        return
    for j in range(robot.n_joints):
        seen = np.flatnonzero(~np.isnan(rows.link_q[:, j]))
        if len(seen) < FEWEST_VALUES:
            continue
        some = seen[np.unique(np.linspace(0, len(seen) - 1, min(ROWS, len(seen))).astype(np.int64))]
        q, link = rows.q[some], rows.link_q[some]
        before = _scatter(link[:, j], q[:, j])
        if before <= NEAR_RAD or np.ptp(link[:, j]) == 0.0:
            continue
        after, k, sign, unit = min(
            (_scatter(link[:, j], q[:, k] * sign / factor), k, sign, words)
            for k in range(q.shape[1])
            for sign in (1.0, -1.0)
            for factor, words in UNITS
        )
        if after * FACTOR > before or np.ptp(q[:, k]) == 0.0:
            continue
        parts = (
            [f"hold joint {k + 1}"] * (k != j)
            + ["count the other way round"] * (sign < 0)
            + [f"be {unit}"] * bool(unit)
        )
        raise ObservationError(
            f"The link-side encoder of joint {j + 1} looks to {' and to '.join(parts)}: the encoders differ by "
            f"{degrees(before):.3g} deg as the rows are, by {degrees(after):.3g} deg without that. Remedy: correct "
            f"column link{j + 1}_deg, or its name, sign and unit in the column map, and upload again.",
            code=FOREIGN,
            joint=robot.joints[j].name,
            before_deg=float(degrees(before)),
            after_deg=float(degrees(after)),
        )


def _scatter(a: Floats, b: Floats) -> float:
    return float(np.std(a - b))
