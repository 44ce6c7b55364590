"""Whether an arm is still as its version says: a few poses measured again, and the one cause that explains them."""

from kilter_core.watch.check import Check, check
from kilter_core.watch.poses import CheckPlan, check_poses

__all__ = ["Check", "CheckPlan", "check", "check_poses"]
