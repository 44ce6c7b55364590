"""Arrays of numbers, whose shapes docstrings state."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
else:
    Floats = "NDArray[np.float64]"  # nobody asks for it while the program runs
