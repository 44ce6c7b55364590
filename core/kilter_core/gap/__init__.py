"""The gap finder: where simulation and measurement disagree, which effect is missing, and how sure that is."""

from kilter_core.gap.find import find_gap
from kilter_core.gap.options import GapOptions
from kilter_core.gap.report.report import GapReport
from kilter_core.gap.report.separation import plan_separation

__all__ = ["GapOptions", "GapReport", "find_gap", "plan_separation"]
