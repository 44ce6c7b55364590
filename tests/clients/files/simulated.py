"""Recordings of a simulated arm, by formulas and writers that share nothing with the client."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

BODY = np.array([[0.0, 0, 0], [90, 0, 10], [0, 70, 25]])


def arm(q_deg: np.ndarray) -> np.ndarray:
    """Three markers (n, 3, 3) on the hand of a turning arm with two more joints, mm."""
    a, b, c = np.radians(q_deg).T
    rz = np.array([[np.cos(a), -np.sin(a), 0 * a], [np.sin(a), np.cos(a), 0 * a], [0 * a, 0 * a, 1 + 0 * a]])
    pitch = b + c
    ry = np.array(
        [[np.cos(pitch), 0 * a, np.sin(pitch)], [0 * a, 1 + 0 * a, 0 * a], [-np.sin(pitch), 0 * a, np.cos(pitch)]]
    )
    flat = np.stack([400 * np.cos(b) + 300 * np.cos(pitch), 0 * a, 500 - 400 * np.sin(b) - 300 * np.sin(pitch)])
    rz, ry = np.moveaxis(rz, 2, 0), np.moveaxis(ry, 2, 0)
    hand = np.einsum("nij,njk,mk->nmi", rz, ry, BODY)
    return hand + np.einsum("nij,jn->ni", rz, flat)[:, None]


def stops(poses: np.ndarray, rest_s: float, move_s: float, t: np.ndarray) -> np.ndarray:
    """Joints at times ``t``: rest at each pose, smooth motion between."""
    cycle = rest_s + move_s
    k = np.clip((t // cycle).astype(int), 0, len(poses) - 1)
    u = np.clip((t - k * cycle - rest_s) / move_s, 0, 1)
    u = u**3 * (10 - 15 * u + 6 * u * u)
    return poses[k] + u[:, None] * (poses[np.minimum(k + 1, len(poses) - 1)] - poses[k])


def wander(t: np.ndarray) -> np.ndarray:
    """Joints that never rest and never repeat."""
    return np.stack(
        [40 * np.sin(0.61 * t) + 11 * np.sin(1.7 * t), 25 * np.sin(0.43 * t + 1) + 7 * np.sin(2.3 * t),
         30 * np.sin(0.77 * t + 2) + 9 * np.cos(1.9 * t)], axis=1,
    )  # fmt: skip


def write_n3d(path: Path, points: np.ndarray, rate: float) -> Path:
    n, m, _ = points.shape
    head = struct.pack("<Bhhif", 32, m, 3, n, rate).ljust(256, b"\0")
    data = np.where(np.isnan(points), np.frombuffer(b"\xee" * 4, "<f4")[0], points).astype("<f4")
    path.write_bytes(head + data.tobytes())
    return path


def write_csv(path: Path, points: np.ndarray, rate: float) -> Path:
    n, m, _ = points.shape
    lines = [f"Number of frames:,{n}", f"Frequency:,{rate:g}", "Units:,mm", ""]
    lines.append(",".join(["Frame", *(f"Marker_{k + 1} {a}" for k in range(m) for a in "xyz")]))
    for i, frame in enumerate(points.reshape(n, -1), 1):
        lines.append(",".join([str(i), *("" if np.isnan(v) else f"{v:.4f}" for v in frame)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def write_log(path: Path, q_deg: np.ndarray, t: np.ndarray | None = None) -> Path:
    names = [f"q{i + 1}_deg" for i in range(q_deg.shape[1])] + (["t_s"] if t is not None else [])
    table = q_deg if t is None else np.column_stack([q_deg, t])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.6f")
    return path
