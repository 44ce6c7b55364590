"""From observations to a calibration: the methods, how far it is known, and the report."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kilter_core.identify.holdout import Folds
    from kilter_core.identify.methods.kalman import Prior
    from kilter_core.identify.options import IdentifyOptions
    from kilter_core.identify.run import Identification, identify

__all__ = ["Folds", "Identification", "IdentifyOptions", "Prior", "identify"]

# Whoever asks only whether rows belong to a robot, as the API process does, does not wait for the methods.
_OF = {
    "Folds": "holdout",
    "Identification": "run",
    "IdentifyOptions": "options",
    "Prior": "methods.kalman",
    "identify": "run",
}


def __getattr__(name: str) -> Any:
    """Import what is asked for by name."""
    if name not in _OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_OF[name]}"), name)
