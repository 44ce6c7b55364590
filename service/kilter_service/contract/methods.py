"""The methods of an identification, made by `make contract` from core/kilter_core/identify/registry.py."""

from __future__ import annotations

from typing import Literal

MethodName = Literal[
    "least_squares", "pose_pseudo_inverse", "influence", "kalman", "global_search", "linear_least_squares"
]
