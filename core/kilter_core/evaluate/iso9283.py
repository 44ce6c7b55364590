"""Performance criteria of ISO 9283:1998 from measurements of commanded poses, or a reason why the data cannot give them.

Symbols are the standard's. Distances are in m, angles in rad: a, b, c are rotations about x, y, z of the difference to
the commanded orientation (small, so their order does not matter).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np

from kilter_core.errors import CoreError, OptionError
from kilter_core.model import Prediction
from kilter_core.observations import Observations
from kilter_core.parameters import degrees, mm
from kilter_core.transforms import rotation_log
from kilter_core.types import Floats, Ints

POSE_CYCLES = 30  # AP, RP, vAP, AD, RD: table of 7.1
PATH_CYCLES = 10  # AT, RT
DRIFT_CYCLES = 10  # per measurement of AP and RP in a drift test
DRIFT_S = 8 * 3600.0
FEWEST_PATH_POINTS = 3


class MetricNotSupportedError(CoreError):
    """Measurements that cannot give a criterion of the standard."""

    default_code = "metric_not_supported"


@dataclass(frozen=True)
class Trial:
    """Attained minus commanded: ``off (N, 3)`` m and ``turned (N, 3)`` rad or None, and how the rows belong together.

    ``commanded (N, 3)`` m; ``pose (N,)`` numbers the commanded poses (or points of a path), ``approach (N,)`` the
    directions of approach or -1, ``series (N,)`` the sessions or -1, ``t (N,)`` s or None. Row order is the order in time.
    """

    commanded: Floats
    off: Floats
    turned: Floats | None
    pose: Ints
    approach: Ints
    series: Ints
    t: Floats | None

    @staticmethod
    def from_observations(commanded: Prediction, observations: Observations) -> Trial:
        """Pair what was commanded with what was measured.

        Raises:
            MetricNotSupportedError: no measured positions.

        """
        o = observations
        if o.position is None:
            raise MetricNotSupportedError(
                "ISO 9283 needs measured tool positions: upload x_mm, y_mm, z_mm.", metric="all"
            )
        turned = None if o.rotation is None else rotation_log(o.rotation @ commanded.rotation.transpose(0, 2, 1))
        none = np.full(len(o), -1, dtype=np.int64)
        way = o.stated_direction
        approach = none if way is None else np.unique(way, axis=0, return_inverse=True)[1].reshape(-1)
        series = none if o.session is None else np.unique(o.session, return_inverse=True)[1].reshape(-1)
        off = o.position - commanded.position
        return Trial(commanded.position, off, turned, o.pose_groups(), approach, series, o.t)

    @cached_property
    def poses(self) -> list[Ints]:
        """Rows of each commanded pose, in time."""
        return [np.flatnonzero(self.pose == p) for p in range(int(self.pose.max()) + 1)]


def accuracy(trial: Trial, rows: Ints) -> float:
    """AP_p of one pose: distance from the commanded point to the barycentre of the attained ones."""
    return float(np.linalg.norm(trial.off[rows].mean(axis=0)))


def repeatability(trial: Trial, rows: Ints) -> float:
    """RP_l of one pose: mean distance to the barycentre plus three standard deviations."""
    distance = np.linalg.norm(trial.off[rows] - trial.off[rows].mean(axis=0), axis=1)
    return float(distance.mean() + 3.0 * distance.std(ddof=1))


def pose_accuracy(trial: Trial) -> dict[str, Any]:
    """AP_p, its coordinates, and AP_a, AP_b, AP_c of every pose."""
    return _over_poses(trial, "AP", accuracy, lambda turns: np.abs(turns.mean(axis=0)))


def pose_repeatability(trial: Trial) -> dict[str, Any]:
    """RP_l, and RP_a, RP_b, RP_c (three standard deviations) of every pose."""
    return _over_poses(trial, "RP", repeatability, lambda turns: 3.0 * turns.std(axis=0, ddof=1))


def multi_directional(trial: Trial) -> dict[str, Any]:
    """Largest distance vAP_p between the barycentres of a pose reached from three directions."""
    found = []
    for number, rows in enumerate(trial.poses):
        ways = [rows[trial.approach[rows] == a] for a in np.unique(trial.approach[rows]) if a >= 0]
        ways = [way for way in ways if len(way) >= POSE_CYCLES]
        if len(ways) >= 3:
            means = np.array([trial.off[way].mean(axis=0) for way in ways])
            apart = np.linalg.norm(means[:, None] - means[None], axis=2)
            found.append({"pose": number + 1, "n": min(map(len, ways)), "ways": len(ways), "m": float(apart.max())})
    if not found:
        _refuse("vAP", f"no pose was reached {POSE_CYCLES} times from each of three directions (dir1 ... dirn)")
    return {"m": max(row["m"] for row in found), "poses": found}


def distance_accuracy(trial: Trial) -> dict[str, Any]:
    """AD_p between two poses visited in turn: mean attained distance minus the commanded one."""
    attained, commanded = _distances(trial, "AD")
    return {"m": abs(float(attained.mean()) - commanded), "n": len(attained), "commanded_m": commanded}


def distance_repeatability(trial: Trial) -> dict[str, Any]:
    """RD: three standard deviations of the distance between two poses visited in turn."""
    attained, commanded = _distances(trial, "RD")
    return {"m": 3.0 * float(attained.std(ddof=1)), "n": len(attained), "commanded_m": commanded}


def path_accuracy(trial: Trial) -> dict[str, Any]:
    """AT_p: largest distance between the commanded path and the barycentres of its points."""
    points = _path(trial, "AT")
    return {"m": max(accuracy(trial, rows) for rows in points), "n": min(map(len, points)), "points": len(points)}


def path_repeatability(trial: Trial) -> dict[str, Any]:
    """RT_p: largest repeatability of a point of the path."""
    points = _path(trial, "RT")
    return {"m": max(repeatability(trial, rows) for rows in points), "n": min(map(len, points)), "points": len(points)}


def accuracy_drift(trial: Trial) -> dict[str, Any]:
    """dAP: largest change of the pose accuracy since the first series."""
    return _drift(trial, "dAP", accuracy)


def repeatability_drift(trial: Trial) -> dict[str, Any]:
    """dRP: largest change of the pose repeatability since the first series."""
    return _drift(trial, "dRP", repeatability)


METRICS: Mapping[str, Callable[[Trial], dict[str, Any]]] = MappingProxyType(
    {
        "AP": pose_accuracy,
        "RP": pose_repeatability,
        "vAP": multi_directional,
        "AD": distance_accuracy,
        "RD": distance_repeatability,
        "AT": path_accuracy,
        "RT": path_repeatability,
        "dAP": accuracy_drift,
        "dRP": repeatability_drift,
    }
)
DEMANDS: Mapping[str, int] = MappingProxyType(
    {
        "AP": POSE_CYCLES,
        "RP": POSE_CYCLES,
        "vAP": POSE_CYCLES,
        "AD": POSE_CYCLES,
        "RD": POSE_CYCLES,
        "AT": PATH_CYCLES,
        "RT": PATH_CYCLES,
        "dAP": DRIFT_CYCLES,
        "dRP": DRIFT_CYCLES,
    }
)


def criteria(trial: Trial, wanted: Sequence[str] = ()) -> dict[str, Any]:
    """Criteria in mm and degrees by symbol, and what was refused: {metrics, refused}.

    All that the data support when ``wanted`` is empty; what is asked for by name must be supported.

    Raises:
        OptionError: a symbol that does not exist. MetricNotSupportedError: one asked for that the data cannot give, or
            none that they can.

    """
    unknown = sorted(set(wanted) - set(METRICS))
    if unknown:
        raise OptionError(f"There is no criterion {unknown[0]!r}. There are: {', '.join(METRICS)}.", option="criteria")
    found, refused = {}, []
    for symbol in wanted or METRICS:
        try:
            found[symbol] = {**_wire(METRICS[symbol](trial)), "demands": DEMANDS[symbol]}
        except MetricNotSupportedError as error:
            if wanted:
                raise
            refused.append({"symbol": symbol, "code": error.code, "message": error.message})
    if not found:
        raise MetricNotSupportedError(
            f"No criterion of ISO 9283 can be given. First of all: {refused[0]['message']}", refused=refused
        )
    return {"metrics": found, "refused": refused}


def _wire(value: Any) -> Any:
    """The same with ``m`` and ``*_m`` in mm and ``rad`` in degrees, names following."""
    if isinstance(value, list):
        return [_wire(v) for v in value]
    if not isinstance(value, dict):
        return value
    out = {}
    for key, v in value.items():
        if key == "m" or key.endswith("_m"):
            out[f"{key}m"] = mm(np.asarray(v)).tolist()
        elif key == "rad":
            out["abc_deg"] = degrees(np.asarray(v)).tolist()
        else:
            out[key] = _wire(v)
    return out


def _over_poses(
    trial: Trial, symbol: str, of_points: Callable[[Trial, Ints], float], of_turns: Callable[[Floats], Floats]
) -> dict[str, Any]:
    found = []
    for number, rows in enumerate(trial.poses):
        if len(rows) < POSE_CYCLES:
            continue
        row: dict[str, Any] = {"pose": number + 1, "n": len(rows), "m": of_points(trial, rows)}
        if trial.turned is not None:
            row["rad"] = of_turns(trial.turned[rows]).tolist()
        if symbol == "AP":
            row["xyz_m"] = trial.off[rows].mean(axis=0).tolist()
        found.append(row)
    if not found:
        most = max(map(len, trial.poses))
        _refuse(symbol, f"no pose was measured {POSE_CYCLES} times (the most is {most})")
    return {"m": max(row["m"] for row in found), "poses": found}


def _distances(trial: Trial, symbol: str) -> tuple[Floats, float]:
    """Attained distances (n,) between the k-th visits of two poses, and the commanded distance."""
    if len(trial.poses) != 2:
        _refuse(symbol, f"distances need exactly two poses in turn, here are {len(trial.poses)}")
    first, second = trial.poses
    n = min(len(first), len(second))
    if n < POSE_CYCLES:
        _refuse(symbol, f"the two poses were visited {n} times in turn, {POSE_CYCLES} are needed")
    reached = trial.commanded + trial.off
    attained = np.linalg.norm(reached[second[:n]] - reached[first[:n]], axis=1)
    return attained, float(np.linalg.norm(trial.commanded[second[0]] - trial.commanded[first[0]]))


def _path(trial: Trial, symbol: str) -> list[Ints]:
    """Rows of each point of a path; every series is one run along it."""
    if np.any(trial.series < 0):
        _refuse(symbol, "a path needs the column session: one number for each run along it")
    runs = int(trial.series.max()) + 1
    if runs < PATH_CYCLES:
        _refuse(symbol, f"the path was followed {runs} times, {PATH_CYCLES} are needed")
    complete = [rows for rows in trial.poses if len(np.unique(trial.series[rows])) == len(rows) == runs]
    if len(complete) < max(FEWEST_PATH_POINTS, len(trial.poses)):
        _refuse(symbol, "every point of the path (pose_id) must be measured exactly once in every run (session)")
    return complete


def _drift(trial: Trial, symbol: str, of_points: Callable[[Trial, Ints], float]) -> dict[str, Any]:
    if len(trial.poses) != 1:
        _refuse(symbol, f"drift is measured at one pose, here are {len(trial.poses)}")
    if trial.t is None or np.any(trial.series < 0):
        _refuse(symbol, "drift needs the columns t_s and session, one session for each measurement")
    t = trial.t
    span = float(np.ptp(t))
    if span < DRIFT_S:
        _refuse(symbol, f"the rows span {span / 3600.0:.1f} h, {DRIFT_S / 3600.0:.0f} h are needed")
    sets = [np.flatnonzero(trial.series == s) for s in range(int(trial.series.max()) + 1)]
    fewest = min(map(len, sets))
    if len(sets) < 2 or fewest < DRIFT_CYCLES:
        _refuse(symbol, f"{len(sets)} sessions of at least {fewest} rows: two or more of {DRIFT_CYCLES} are needed")
    sets.sort(key=lambda rows: float(np.mean(t[rows])))
    values = [of_points(trial, rows) for rows in sets]
    return {"m": max(abs(v - values[0]) for v in values), "n": fewest, "series_m": values}


def _refuse(symbol: str, why: str) -> NoReturn:
    raise MetricNotSupportedError(
        f"{symbol} of ISO 9283 cannot be given: {why}. Measure what is missing, or ask for other metrics.",
        metric=symbol,
        repeats=DEMANDS[symbol],
    )
