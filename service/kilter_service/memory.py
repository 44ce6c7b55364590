"""How the API process gives memory back."""

from __future__ import annotations

import ctypes
import os

# Of <malloc.h>. Every thread that works on a body would get an arena of its own, up to eight for each core, and what is
# freed in one is of no use to the others: forty threads kept as much as all bodies that they ever held at once.
M_ARENA_MAX, ARENAS = -8, 2
ARROW_POOL = "ARROW_DEFAULT_MEMORY_POOL"


def keep_small() -> None:
    """Let threads share their memory; to be called before they start. Does nothing where the system has no such setting."""
    # Arrow's own allocator keeps what it had for itself, beside malloc's.
    os.environ.setdefault(ARROW_POOL, "system")
    try:
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, ARENAS)
    except (AttributeError, OSError):
        return
