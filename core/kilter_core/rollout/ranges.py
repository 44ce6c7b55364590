"""Ranges of what a search found, and draws of all numbers of a joint together, for training on many simulated arms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kilter_core.rollout.search import JointFindings, covariance
from kilter_core.types import QUANTILE

LEVEL = 0.95  # to which QUANTILE belongs


def draw_ranges(joints: Sequence[JointFindings], draws: int = 100, seed: int = 0) -> dict[str, Any]:
    """Return ranges of each number of each joint, and ``draws`` of all of them, in SI as MJCF has them.

    Numbers of one joint are drawn together, from the covariance of their fit with each second as one observation; numbers
    that cannot be negative are drawn as their logarithms.
    """
    rng = np.random.default_rng(seed)
    parameters: list[dict[str, Any]] = []
    drawn: list[dict[str, float]] = [{} for _ in range(draws)]
    for found in joints:
        fit, record = found.believed, found.record
        spread = covariance(record, fit, found.split.train)
        logs = np.array([number.scale == "log" for number in fit.fitted])
        values = np.array([fit.p[number.place] for number in fit.fitted])
        centre = np.where(logs, np.log(np.maximum(values, 1e-300)), values / fit.scales)
        sigma = np.sqrt(np.diag(spread))
        samples = rng.multivariate_normal(centre, spread, draws, method="svd")
        keys = [f"{record.name}.{key}" for key in fit.names]
        for k, (number, key) in enumerate(zip(fit.fitted, keys, strict=True)):
            low, high = (
                _from_fit(centre[k] + sign * QUANTILE * sigma[k], logs[k], fit.scales[k]) for sign in (-1.0, 1.0)
            )
            low, high = max(low, number.low), min(high, number.high)
            parameters.append({"name": key, "unit": number.unit, "value": float(values[k]), "low": low, "high": high})
            for one, x in zip(drawn, samples[:, k], strict=True):
                one[key] = float(np.clip(_from_fit(x, logs[k], fit.scales[k]), number.low, number.high))
    return {"level": LEVEL, "parameters": parameters, "draws": drawn}


def _from_fit(x: float, log: bool, scale: float) -> float:
    return float(np.exp(x)) if log else float(x * scale)
