"""Whether an arm is still as its version says: a few poses measured again, and the one cause that explains them."""

from kilter_core.watch.check import Check, check

__all__ = ["Check", "check"]
