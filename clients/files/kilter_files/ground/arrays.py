"""Arrays of numbers, whose shapes docstrings state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
