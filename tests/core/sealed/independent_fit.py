"""Real campaigns read, and arms fitted, by nothing but numpy and scipy: what Kilter's identification is compared with.

An arm is a row of joints and the fixed motions between them, written down from the papers and files that come with the
data. Six small numbers behind every joint, beside base and tool, span all errors of its geometry; a wide prior decides what
rows leave open. Nothing here imports Kilter.
"""

from __future__ import annotations

import csv
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

LENGTH_SIGMA_M, ANGLE_SIGMA_RAD = 5e-3, 2e-2  # of what a constant is off by
PASSES = 3  # of fits, each with the noise that the one before leaves


@dataclass(frozen=True)
class Arm:
    """Joints that rotate about ``axes (n, 3)``, ``signs (n,)`` times their reading, and motions (4, 4) beside them."""

    axes: Floats
    signs: Floats
    before: Floats
    behind: Floats

    def flange(self, q: Floats, errors: Floats) -> Floats:
        """Poses (N, 4, 4) of the flange at readings (N, n), with small motions (n, 6) behind each joint."""
        T = np.broadcast_to(self.before, (len(q), 4, 4))
        for k, axis in enumerate(self.axes):
            turned = np.zeros((len(q), 4, 4))
            turned[:, :3, :3] = Rotation.from_rotvec(np.outer(self.signs[k] * q[:, k], axis)).as_matrix()
            turned[:, 3, 3] = 1.0
            T = T @ (turned @ (motion(errors[k]) @ self.behind[k]))
        return T


@dataclass(frozen=True)
class Campaign:
    """Readings ``q (N, n)`` rad, ``points (N, m, 3)`` m and perhaps ``turns (N, 3, 3)`` of a real arm, in the order of time."""

    arm: Arm
    q: Floats
    points: Floats
    turns: Floats | None = None

    def select(self, rows: NDArray[np.int64]) -> Campaign:
        """Some of the rows."""
        turns = None if self.turns is None else self.turns[rows]
        return Campaign(self.arm, self.q[rows], self.points[rows], turns)


def motion(six: Floats) -> Floats:
    """A motion (4, 4): a shift, then a rotation vector."""
    T = np.eye(4)
    T[:3, 3] = six[:3]
    T[:3, :3] = Rotation.from_rotvec(six[3:]).as_matrix()
    return T


def held_out_rms_mm(train: Campaign, unseen: Campaign) -> float:
    """Root mean square distance of points (mm) in rows that a fit of all geometry never saw."""
    p, m = _fit(train), train.points.shape[1]
    points, _ = _predict(train.arm, unseen.q, p, m)
    return float(1e3 * np.sqrt(np.nanmean(np.sum((points - unseen.points) ** 2, axis=2))))


def _predict(arm: Arm, q: Floats, p: Floats, count: int) -> tuple[Floats, Floats]:
    """Points (N, m, 3) and rotations (N, 3, 3) of the tool: base (6), errors (6 n), points (3 m), rotation (3)."""
    n = len(arm.axes)
    T = motion(p[:6]) @ arm.flange(q, p[6 : 6 + 6 * n].reshape(n, 6))
    tool = p[6 + 6 * n : 6 + 6 * n + 3 * count].reshape(count, 3)
    points = T[:, None, :3, 3] + tool @ T[:, :3, :3].transpose(0, 2, 1)
    return points, T[:, :3, :3] @ Rotation.from_rotvec(p[-3:]).as_matrix()


def _fit(train: Campaign) -> Floats:
    """Least squares from a registration of the flange; position and rotation weigh by what they leave."""
    arm, (_, count) = train.arm, train.points.shape[:2]
    n = len(arm.axes)
    wide = np.concatenate(
        [np.full(6, 1e3), np.tile([LENGTH_SIGMA_M] * 3 + [ANGLE_SIGMA_RAD] * 3, n), np.full(3 * count + 3, 1e3)]
    )
    scale = np.where(
        wide > 1.0, np.concatenate([[0.1] * 3 + [0.3] * 3, np.ones(6 * n), np.full(3 * count + 3, 0.1)]), wide
    )
    p = np.zeros(len(wide))
    p[:6] = _register(arm.flange(train.q, np.zeros((n, 6)))[:, :3, 3], train.points.mean(axis=1))
    if train.turns is not None:
        flange = motion(p[:6])[:3, :3] @ arm.flange(train.q, np.zeros((n, 6)))[:, :3, :3]
        p[-3:] = Rotation.from_matrix(flange.transpose(0, 2, 1) @ train.turns).mean().as_rotvec()

    def residuals(p: Floats, sigma: tuple[float, float]) -> Floats:
        points, turns = _predict(arm, train.q, p, count)
        parts = [np.nan_to_num((points - train.points).ravel()) / sigma[0], p / wide]
        if train.turns is not None:
            off = Rotation.from_matrix(turns.transpose(0, 2, 1) @ train.turns).as_rotvec()
            parts.append(off.ravel() / sigma[1])
        return np.concatenate(parts)

    def left(p: Floats) -> tuple[float, float]:
        r, size = residuals(p, (1.0, 1.0)), train.points.size
        turns = r[size + len(p) :]
        return float(np.sqrt(np.mean(r[:size] ** 2))), float(np.sqrt(np.mean(turns**2))) if len(turns) else 1.0

    sigma = 1e-3, 1e-3
    for _ in range(PASSES):
        p = least_squares(residuals, p, x_scale=scale, args=(sigma,), method="trf").x
        sigma = left(p)
    return np.asarray(p)


def _register(here: Floats, there: Floats) -> Floats:
    """The motion (6,) that brings points onto others best (Kabsch)."""
    U, _, Vt = np.linalg.svd((here - here.mean(axis=0)).T @ (there - there.mean(axis=0)))
    R = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    return np.concatenate([there.mean(axis=0) - R @ here.mean(axis=0), Rotation.from_matrix(R).as_rotvec()])


def ur10(folder: Path, series: str) -> Campaign:
    """Poses that a laser tracker measured; the tool's Euler angles are about its own axes x, y, z."""
    table = [  # d, a, alpha of Denavit and Hartenberg
        (0.1273, 0.0, np.pi / 2), (0.0, -0.612, 0.0), (0.0, -0.5723, 0.0),
        (0.163941, 0.0, np.pi / 2), (0.1157, 0.0, -np.pi / 2), (0.0922, 0.0, 0.0),
    ]  # fmt: skip
    behind = [_shift(0, 0, d) @ _shift(a, 0, 0) @ _turn(alpha, 0, 0) for d, a, alpha in table]
    arm = Arm(np.tile([0.0, 0.0, 1.0], (6, 1)), np.ones(6), np.eye(4), np.array(behind))
    name = {"A": "Series_A/measurements_grid.csv", "B": "Series_B/measurements_joint_configurations.csv"}[series]
    with (folder / "ipa-ur10-lasertracker" / name).open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file, delimiter=";"))

    def column(key: str) -> Floats:
        return np.array([float(row[key].replace(",", ".")) for row in rows])

    joints = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    q = np.column_stack([column(f"{joint}_joint") for joint in joints])
    points = 1e-3 * np.column_stack([column(f"measurement_{k}") for k in "xyz"])
    angles = np.column_stack([column(f"measurement_r{k}") for k in "xyz"])
    return Campaign(arm, q, points[:, None], Rotation.from_euler("XYZ", angles, degrees=True).as_matrix())


def fanuc(folder: Path) -> Campaign:
    """Three markers at 24 configurations, ten times each."""
    read = loadmat(folder / "fanuc-r2000-3markers/calibration_dataset.mat")
    x, y = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]
    behind = [
        _shift(0.312, 0, 0) @ _turn(0, -np.pi / 2, 0), _shift(1.075, 0, 0) @ _turn(0, np.pi / 2, 0),
        _shift(1.28, 0, 0.225), np.eye(4), np.eye(4), _shift(0.215, 0, 0),
    ]  # fmt: skip
    arm = Arm(
        np.array([[0.0, 0.0, 1.0], y, y, x, y, x]), np.array([1.0, 1.0, -1.0, -1.0, -1.0, -1.0]), _shift(0, 0, 0.67),
        np.array(behind),
    )  # fmt: skip
    return Campaign(arm, read["q"], np.stack([read[name] for name in ("mA", "mB", "mC")], axis=1))


def talos(folder: Path) -> Campaign:
    """A humanoid's torso and left arm, from its URDF."""
    root = ET.parse(folder / "talos-arm/talos_full_v2.urdf").getroot()
    above = {one.find("child").get("link"): one for one in root.findall("joint")}  # type: ignore[union-attr]
    joints, link = [], "arm_left_7_link"
    while link != "base_link":
        joints.append(above[link])
        link = above[link].find("parent").get("link")  # type: ignore[union-attr, assignment]
    axes, names, fixed = [], [], [np.eye(4)]
    for joint in reversed(joints):
        origin = joint.find("origin")
        xyz, rpy = (_numbers(origin.get(key) if origin is not None else None) for key in ("xyz", "rpy"))
        fixed[-1] = fixed[-1] @ _shift(*xyz) @ _turn(*rpy)
        if joint.get("type") != "fixed":
            axes.append(_numbers(joint.find("axis").get("xyz")))  # type: ignore[union-attr]
            names.append(str(joint.get("name")))
            fixed.append(np.eye(4))
    arm = Arm(np.array(axes), np.ones(len(axes)), fixed[0], np.array(fixed[1:]))
    with (folder / "talos-arm/talos_left_arm_02_10_contact.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    read = np.array([[float(row[key]) for key in (*names, "x1", "y1", "z1")] for row in rows])
    return Campaign(arm, read[:, :-3], read[:, None, -3:])


def _numbers(text: str | None) -> Floats:
    return np.array([float(word) for word in (text or "0 0 0").split()])


def _shift(x: float, y: float, z: float) -> Floats:
    return motion(np.array([x, y, z, 0.0, 0.0, 0.0]))


def _turn(roll: float, pitch: float, yaw: float) -> Floats:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    return T
