"""How often an effect that is hidden in a REAL log is named: real noise, real friction, and a truth that is known.

``python -m tests.core.motion.inject --share 1.0``: each of ten effects at each joint that the model explains. What rigid
bodies, offsets, Coulomb and viscous friction cannot imitate of it is as large (rms) as what the search leaves of that joint's
torque, times the share; where that is less than a tenth of it, it is not hidden. What the log shows by itself is told first; an
effect that it shows already at that joint is not counted. Nothing here shares code with the search.

``--control 30`` hides nothing: what bodies and friction leave of each joint is moved to another time and perhaps turned over,
thirty times. It is as noisy, as bursty and as slow as the real rest, and knows nothing of the motion.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.io import loadmat
from scipy.signal import savgol_filter

from kilter_core.arm.documents import robot_from_document
from kilter_core.motion import find_missing_torque, to_document
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import reversed_softly
from tests.core.truth import Floats

DATA = Path(__file__).parents[4] / "shared" / "data"
TIAGO, KUKA = DATA / "tiago-dynamic", DATA / "kuka-kr300-secondary-encoder"
WINDOW, SOFT_RAD_S = 31, 0.01
THINNED = 5  # rows to one by which is measured what a model can imitate
LEAST_SEEN = 0.1  # share of an effect that a model must leave
ALIKE = 1e-3  # of the largest singular value, below which columns count as the same
BREAK_S = 1.0
APART_S = 3.0  # by which what is left is moved at least

Step = tuple[str, float] | str
# Of TIAGo's description (Apache-2.0): x, y, z in mm and angles in degrees before each joint, which turns or lifts about z.
TIAGO_STEPS: tuple[tuple[Step, ...], ...] = (
    (("Tx", -62.0), ("Tz", 790.0), "Tz"),
    (("Tx", 155.05), ("Ty", 14.0), ("Tz", -151.0), ("Rz", -90.0), "Rz"),
    (("Tx", 125.0), ("Ty", 16.5), ("Tz", -31.0), ("Rx", 90.0), "Rz"),
    (("Tx", 89.5), ("Tz", 1.5), ("Rz", 90.0), ("Rx", -90.0), "Rz"),
    (("Tx", -20.0), ("Ty", -27.0), ("Tz", -222.0), ("Ry", -90.0), ("Rx", -90.0), "Rz"),
    (("Tx", -162.0), ("Ty", 20.0), ("Tz", 27.0), ("Ry", -90.0), "Rz"),
    (("Tz", 150.0), ("Rz", -90.0), ("Ry", -90.0), "Rz"),
    (("Rz", 90.0), ("Rx", 90.0), "Rz"),
)
# Newton metres of a unit of the logged effort, by its sign too; the torso's is as it is.
TIAGO_NM = np.array([1.0, 13.6, 13.6, -8.7, -8.7, -29.2, -29.2, -29.2])
KUKA_STEPS: tuple[tuple[Step, ...], ...] = (
    (("Rx", 180.0), "Rz"),
    (("Tz", -675.0), ("Tx", 350.0), ("Rx", 90.0), "Rz"),
    (("Tz", -189.0), ("Tx", 1150.0), "Rz"),
    (("Rz", 90.0), ("Tz", 189.0), ("Tx", 41.0), ("Rx", -90.0), "Rz"),
    (("Tz", -1000.0), ("Rx", 90.0), "Rz"),
    (("Rx", -90.0), "Rz"),
)
KUKA_RATIOS = np.array([256.857, 267.429, 252.333, 221.0, 239.619, 154.323])


@dataclass(frozen=True)
class RealLog:
    """A robot document and its log: ``t (N,)`` s, ``q`` and ``tau (N, n)``."""

    document: dict[str, Any]
    t: Floats
    q: Floats
    tau: Floats

    @property
    def stretches(self) -> list[np.ndarray[Any, Any]]:
        """Rows of each stretch without a gap."""
        return np.split(np.arange(len(self.t)), 1 + np.flatnonzero(np.diff(self.t) > BREAK_S))

    def by_stretch(self, change: Callable[[Floats, Floats], Floats], signal: Floats) -> Floats:
        """``change(t, signal)`` of each stretch by itself."""
        return np.concatenate([change(self.t[rows], signal[rows]) for rows in self.stretches])

    def smooth(self, order: int) -> Floats:
        """Joints (N, n), smooth, or what they do in time."""

        def filtered(t: Floats, q: Floats) -> Floats:
            step = float(np.median(np.diff(t)))
            return np.asarray(savgol_filter(q, WINDOW, 3, deriv=order, delta=step, axis=0))

        return self.by_stretch(filtered, self.q)


def tiago() -> RealLog:
    """Torso and arm of TIAGo, one motion of 80 s; three of its channels hold hardly a signal."""
    t, *q = np.loadtxt(TIAGO / "tiago_position.csv", delimiter=",", skiprows=1).T
    effort = np.loadtxt(TIAGO / "tiago_effort.csv", delimiter=",", skiprows=1)[:, 1:]
    return RealLog(document_of("tiago", TIAGO_STEPS), t, np.column_stack(q), TIAGO_NM * effort)


def kuka() -> RealLog:
    """A KR300 in three motions of 10 s; its torques are those of the motors, here behind the gears."""
    parts = []
    for k, name in enumerate("ABC"):
        log = loadmat(KUKA / f"traj_{name}.mat", squeeze_me=True, struct_as_record=False)["rec"]
        t = log.time_cont - log.time_cont[0] + 100.0 * k
        parts.append((t, np.radians(log.act_pos_mot_deg.T), KUKA_RATIOS * log.act_torque_abs_nm.T))
    t, q, tau = (np.concatenate(one) for one in zip(*parts, strict=True))
    return RealLog(document_of("kr300", KUKA_STEPS), t, q, tau)


def document_of(name: str, steps: tuple[tuple[Step, ...], ...]) -> dict[str, Any]:
    """A robot document of fixed steps, each joint the last step of its row."""
    joints, elements = [], []
    for j, row in enumerate(steps, start=1):
        *fixed, axis = row
        elements += [{"axis": step[0], "value": step[1], "fixed": True} for step in fixed]
        elements.append({"axis": str(axis), "joint": f"j{j}"})
        unit = "mm" if str(axis).startswith("T") else "deg"
        joints.append({"name": f"j{j}", f"limits_{unit}": [-400.0, 400.0] if unit == "mm" else [-180.0, 180.0]})
    return {"name": name, "convention": "chain", "joints": joints, "elements": elements}


def as_pinocchio(log: RealLog) -> pin.Model:
    """The arm in Pinocchio, with a ball at each joint."""
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for element in log.document["elements"]:
        axis, value = element["axis"], element.get("value", 0.0)
        if "joint" in element:
            joint = pin.JointModelPZ() if axis == "Tz" else pin.JointModelRZ()
            parent = model.addJoint(parent, joint, place, element["joint"])
            model.appendBodyToJoint(parent, pin.Inertia.FromSphere(2.0, 0.05), pin.SE3(np.eye(3), np.full(3, 0.1)))
            place = pin.SE3.Identity()
            continue
        step = np.eye(3)["xyz".index(axis[1])]
        turn = pin.exp3(np.radians(value) * step) if axis[0] == "R" else np.eye(3)
        place = place * pin.SE3(turn, 1e-3 * value * step * (axis[0] == "T"))
    return model


def gravity_like(log: RealLog) -> Floats:
    """Gravity torques (N, n) of those balls: a load that friction may follow."""
    model = as_pinocchio(log)
    data = model.createData()
    return np.array([pin.computeGeneralizedGravity(model, data, row) for row in log.q])


def columns(log: RealLog, thin: int) -> Floats:
    """Torques (N, n, p) of bodies, offsets and friction by speed, of every ``thin``-th row."""
    q, qd, qdd = (log.smooth(order)[::thin] for order in range(3))
    model, n = as_pinocchio(log), q.shape[1]
    data = model.createData()
    bodies = np.array(
        [pin.computeJointTorqueRegressor(model, data, *row).copy() for row in zip(q, qd, qdd, strict=True)]
    )
    own = np.stack([np.ones_like(qd), reversed_softly(qd, SOFT_RAD_S), qd], axis=2)
    friction = (np.eye(n)[:, :, None] * own[:, :, None, :]).reshape(len(q), n, -1)
    return np.concatenate([bodies, friction], axis=2)


def seen_share(log: RealLog, weights: Floats) -> Callable[[Floats, int], float]:
    """How much (rms, of one) of a torque at a joint bodies, offsets and friction by speed cannot imitate; ``weights (n,)``."""
    X = columns(log, THINNED) * weights[:, None]
    rows, n = X.shape[:2]
    X = X.reshape(rows * n, -1)
    size = np.linalg.norm(X, axis=0)
    u, s, _ = np.linalg.svd(X[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    known = u[:, s > ALIKE * s[0]]

    def share(torque: Floats, j: int) -> float:
        y = np.zeros((rows, n))
        y[:, j] = torque[::THINNED] - torque[::THINNED].mean()
        flat = y.reshape(-1)
        return float(np.linalg.norm(flat - known @ (known.T @ flat)) / np.linalg.norm(flat))

    return share


def shapes(log: RealLog) -> dict[str, Callable[[int], Floats]]:
    """Torque (N,) of each effect at a joint, of no particular size."""
    q, qd, qdd = (log.smooth(order) for order in range(3))
    load, usual = gravity_like(log), np.quantile(np.abs(qd), 0.95, axis=0)
    side = reversed_softly(qd, SOFT_RAD_S)

    def rate(j: int) -> Floats:
        def slope(t: Floats, tau: Floats) -> Floats:
            return np.asarray(savgol_filter(tau, WINDOW, 2, deriv=1, delta=float(np.median(np.diff(t)))))

        return log.by_stretch(slope, log.tau[:, j])

    return {
        "stribeck": lambda j: side[:, j] * np.exp(-np.abs(qd[:, j]) / (0.16 * usual[j])),
        "root_speed": lambda j: side[:, j] * np.sqrt(np.abs(qd[:, j])),
        "one_sided_damping": lambda j: np.maximum(qd[:, j], 0.0),
        "load_friction": lambda j: side[:, j] * np.abs(load[:, j]),
        "motor_inertia": lambda j: qdd[:, j],
        "gear_ripple": lambda j: np.sin(24.0 * q[:, j] + 1.0),
        "spring": lambda j: q[:, j] - 0.2,
        "cable_curve": lambda j: (q[:, j] - q[:, j].mean()) ** 3,
        "drive_gain": lambda j: log.tau[:, j],
        "torque_delay": lambda j: -rate(j),
    }


def search(log: RealLog, tau: Floats) -> dict[str, Any]:
    """What a search says of these torques."""
    rows = Observations(q=log.q, t=log.t, tau=tau)
    found: dict[str, Any] = to_document(find_missing_torque(robot_from_document(log.document), rows))
    return found


def named_in(document: dict[str, Any]) -> set[tuple[str, int]]:
    """Effects and joints, from 1, that are named and not contradicted."""
    return {(one["id"], one["joints"][0]) for one in document["effects"] if one["verdict"] != "contradicted"}


def score(log: RealLog, share: float) -> Counter[tuple[str, str]]:
    """Count by effect: hidden, right, another member of its class, said not to be testable, and what was named besides."""
    clean = search(log, log.tau)
    shown = named_in(clean)
    unexplained = {j for one in clean["warnings"] if one["code"] == "torques_unexplained" for j in one["joints"]}
    print("shown by the log itself:", sorted(shown) or "nothing", "- not explained: joints", sorted(unexplained))
    counts: Counter[tuple[str, str]] = Counter()
    used = np.array([one["joint"] not in unexplained and not one["at_rest"] for one in clean["motion"]["joints"]])
    seen = seen_share(log, used / np.array([one["found"] for one in clean["motion"]["joints"]]))
    for name, shape in shapes(log).items():
        for joint in clean["motion"]["joints"]:
            j = joint["joint"] - 1
            if not used[j] or (name, j + 1) in shown:
                continue
            hidden = shape(j)
            left = seen(hidden, j)
            if left < LEAST_SEEN:
                continue
            tau = log.tau.copy()
            tau[:, j] += share * joint["found"] * hidden / (left * float(np.std(hidden)))
            document = search(log, tau)
            named = named_in(document)
            classes = {
                (member, one["joints"][0]) for one in document["effects"] for member in one["physical_class"]["members"]
            }
            alias = (name, j + 1) in {(one["id"], one["joints"][0]) for one in document["not_testable"]}
            right = (name, j + 1) in named
            counts[name, "hidden"] += 1
            counts[name, "right"] += right
            counts[name, "its class"] += not right and (name, j + 1) in classes
            counts[name, "not testable"] += not right and alias
            counts[name, "besides"] += bool(named - shown - {(name, j + 1)})
            counts[name, "sure and wrong"] += any(
                one["verdict"] in ("confirmed", "replicated")
                and (one["id"], one["joints"][0]) not in shown | {(name, j + 1)}
                for one in document["effects"]
            )
    return counts


def control(log: RealLog, times: int) -> Counter[str]:
    """Count logs in which nothing is hidden but the log's own rest at another time: named in them, and sure."""
    X, weights = columns(log, 1), 1.0 / log.tau.std(axis=0)
    for _ in range(3):
        flat = (X * weights[:, None]).reshape(log.tau.size, -1)
        size = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
        theta = np.linalg.lstsq(flat / size, (log.tau * weights).reshape(-1), rcond=1e-6)[0] / size
        left = log.tau - X @ theta
        weights = 1.0 / left.std(axis=0)
    draw, apart = np.random.default_rng(0), int(APART_S / np.median(np.diff(log.t)))
    counts: Counter[str] = Counter()
    for _ in range(times):
        moved = [np.roll(one, draw.integers(apart, len(one) - apart)) * draw.choice([-1.0, 1.0]) for one in left.T]
        document = search(log, X @ theta + np.column_stack(moved))
        sure = [one for one in document["effects"] if one["verdict"] not in ("provisional", "contradicted")]
        counts += Counter({"logs": 1, "named": bool(named_in(document)), "sure": bool(sure)})
    return counts


def main() -> None:
    """Print how often names are right, by log and effect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--log", choices=("tiago", "kuka"), action="append", help="default: both")
    parser.add_argument("--share", type=float, default=1.0, help="size of the effect as a share of what is left")
    parser.add_argument("--control", type=int, metavar="N", help="hide nothing, N times")
    asked = parser.parse_args()
    for name in asked.log or ("tiago", "kuka"):
        began, log = time.monotonic(), {"tiago": tiago, "kuka": kuka}[name]()
        if asked.control:
            print(f"{name:6} nothing hidden", dict(control(log, asked.control)), flush=True)
            continue
        counts = score(log, asked.share)
        for effect in dict.fromkeys(effect for effect, _ in counts):
            print(f"{name:6} {effect:20}", {what: n for (one, what), n in counts.items() if one == effect})
        total = {what: sum(n for (_, one), n in counts.items() if one == what) for _, what in counts}
        print(f"{name:6} {'all':20}", total, f"{time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
