"""The gap finder: where simulation and measurement disagree, which effect is missing, and how sure that is."""

from core.gap.options import GapOptions
from core.gap.plan import plan_separation
from core.gap.report import GapReport
from core.gap.run import find_gap

__all__ = ["GapOptions", "GapReport", "find_gap", "plan_separation"]
