"""Arrays of numbers, of indices and of truth values, whose shapes docstrings state."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Bools = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
else:
    Bools = "NDArray[np.bool_]"
    Floats = "NDArray[np.float64]"  # nobody asks for it while the program runs
    Ints = "NDArray[np.int64]"
