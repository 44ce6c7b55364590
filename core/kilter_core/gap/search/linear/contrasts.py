"""What repeats differ by, and how much of it a fit takes: names that follow the clock or the temperature fit noise too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kilter_core.gap.noise.visits import isolate_unused_visits
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Ints


def fitted_away(problem: LinearizedProblem, columns: Sequence[int], condition: Ints) -> float:
    """How many scalars of the differences between visits of one ``condition (V,)`` the library columns fit.

    The noise in them is gone from the residual. Geometry fits none: it is the same for all visits of a condition.
    """
    used = problem.settings.used
    basis = problem.basis(columns)[:, problem.U.shape[1] :]
    if not basis.shape[1]:
        return 0.0
    rows = basis.reshape(len(used), -1)
    return float(np.sum(subtract_group_means(rows, isolate_unused_visits(condition, used)) ** 2))
