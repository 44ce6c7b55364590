"""Whether an arm is still as its version says: a few poses measured again, and the one cause that explains them."""

from kilter_core.watch.arm_check import Check, check
from kilter_core.watch.conditions import UNSTATED_K, Conditions
from kilter_core.watch.history import Chart, chart, cusum_limit
from kilter_core.watch.poses import CheckPlan, check_poses
from kilter_core.watch.setup_scatter import learned_setup
from kilter_core.watch.zero_offsets import Rezeroed, rezero

__all__ = [
    "UNSTATED_K",
    "Chart",
    "Check",
    "CheckPlan",
    "Conditions",
    "Rezeroed",
    "chart",
    "check",
    "check_poses",
    "cusum_limit",
    "learned_setup",
    "rezero",
]
