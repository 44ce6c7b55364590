"""The gap finder: where simulation and measurement disagree, which effect is missing, and how sure that is."""

from kilter_core.gap.options import GapOptions
from kilter_core.gap.plan import plan_separation
from kilter_core.gap.report import GapReport
from kilter_core.gap.run import find_gap

__all__ = ["GapOptions", "GapReport", "find_gap", "plan_separation"]
