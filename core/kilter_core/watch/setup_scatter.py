"""How well a set-up repeats, learned from earlier checks: by how much more the base seems to shift than each check knows."""

from __future__ import annotations

import numpy as np

from kilter_core.types import Floats

UNLEARNED = 5e-5  # m, before a check has shown it: a tracker that is set up again on its marks
TAKEN = 6  # numbers that this counts as: two checks beyond the first
RANGE = (1e-6, 2e-3)  # m, between which it is looked for
STEPS = 200


def learned_setup(shifts: Floats, sigmas: Floats) -> float:
    """Standard deviation (m) with which a set-up repeats, by shifts (N, 3) of the base in N checks and their own ``sigmas``.

    The likeliest beside ``UNLEARNED``; shifts that all checks have alike are the version's.
    """
    if len(shifts) < 2:
        return UNLEARNED
    weight = 1.0 / (UNLEARNED**2 + sigmas**2)
    away = shifts - np.sum(weight * shifts, axis=0) / np.sum(weight, axis=0)
    away *= np.sqrt(len(shifts) / (len(shifts) - 1.0))
    tried = np.geomspace(*RANGE, STEPS)
    total = tried[:, None, None] ** 2 + sigmas**2
    loss = np.sum(np.log(total) + away**2 / total, axis=(1, 2))
    loss += TAKEN * (2.0 * np.log(tried) + (UNLEARNED / tried) ** 2)
    return float(tried[int(np.argmin(loss))])
