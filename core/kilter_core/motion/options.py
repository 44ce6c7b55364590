"""What a search in torques can be asked."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionOptions:
    """``seed`` chooses the motions that are held out."""

    seed: int = 0
