"""What the user of the arm believes of its masses: never quite what they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arms import Drawn
from tests.blind.generator.options import Options

Floats = NDArray[np.float64]


def believed(drawn: Drawn, options: Options, rng: np.random.Generator) -> dict[str, Any]:
    """The robot document with its link masses and centres off by as much as the case says."""
    mass = drawn.mass * (1.0 + options.mass_error * rng.uniform(-1.0, 1.0, drawn.n))
    com = drawn.com + options.com_error_mm * 1e-3 * rng.uniform(-1.0, 1.0, (drawn.n, 3))
    return drawn.document(mass, com)


def told(payload: Floats, options: Options, rng: np.random.Generator) -> Floats:
    """Payload (V,) kg as the user wrote it down."""
    return np.asarray(payload * (1.0 + options.payload_error * rng.choice([-1.0, 1.0])))


def hung(options: Options, rng: np.random.Generator) -> Floats:
    """Where (3,) m from the tool point the payload really hangs."""
    return np.asarray(rng.uniform(-1.0, 1.0, 3) * options.payload_offset_mm * 1e-3)
