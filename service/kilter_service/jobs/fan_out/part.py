"""One part as it travels to where it is computed, and its answer on the way back. This module imports little."""

from __future__ import annotations

import pickle
import platform
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from kilter_core.errors import CoreError
from kilter_core.types import unheard
from kilter_service.ground.version import code_version

COUNTED = ("numpy", "scipy", "numba")  # packages whose release may change the last digit of a number
Packed = bytes | Path


@cache
def release() -> str:
    """Return what must be the same everywhere, or one part would be computed otherwise than the next."""
    packages = ", ".join(f"{name} {version(name)}" for name in COUNTED)
    return f"Kilter {code_version()}, Python {platform.python_version()}, {packages}"


def pack(work: Callable[..., Any], task: Any) -> bytes:
    """Return a part as bytes."""
    return pickle.dumps((work, task), pickle.HIGHEST_PROTOCOL)


def compute(packed: Packed, wanted: str) -> Packed:
    """Compute a part where ``release()`` is the ``wanted`` one; what came as a file is answered in another.

    The answer holds what the work returned, or the error that it raised.
    """
    answer = pickle.dumps(_run_packed_part(packed, wanted), pickle.HIGHEST_PROTOCOL)
    if isinstance(packed, bytes):
        return answer
    path = packed.with_suffix(".answer")
    path.write_bytes(answer)
    return path


def unpack(answer: Packed) -> Any:
    """Return what the work returned.

    Raises:
        Exception: what it raised.

    """
    found, error = pickle.loads(answer if isinstance(answer, bytes) else answer.read_bytes())  # noqa: S301 (our own)
    if error is not None:
        raise error
    return found


def _run_packed_part(packed: Packed, wanted: str) -> tuple[Any, Exception | None]:
    if release() != wanted:
        message = (
            f"The worker of the cluster on {platform.node()} has {release()}; the job is computed with {wanted}. "
            "Install the same there, and ask for the job again."
        )
        return None, CoreError(message, code="cluster_differs", worker=release(), wanted=wanted)
    try:
        work, task = pickle.loads(packed if isinstance(packed, bytes) else packed.read_bytes())  # noqa: S301 (our own)
        return work(task, unheard), None
    except Exception as error:  # raised again where the job runs
        return None, error
