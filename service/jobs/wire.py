"""What several kinds of job share: limits of the version they make, and numbers that JSON can hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError

from core.errors import OptionError
from service.contract.versions import CorrectionLimits


def version_limits(limits: Any) -> CorrectionLimits:
    """Read the option ``limits`` of a kind that makes a version.

    Raises:
        OptionError: a limit that does not exist or cannot be.

    """
    try:
        return CorrectionLimits.model_validate(limits or {})
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise OptionError(f"options.limits.{place}: {first['msg']}.", option="limits") from error


def plain(value: Any) -> Any:
    """Return a document with Python's own types, and None where a number is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
