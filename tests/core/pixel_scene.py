"""An arm that a camera watches, as Pinocchio moves it and plain numpy draws it: nothing here imports the core's camera."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from kilter_core.observations import Observations
from kilter_core.observations.rig import Board, Camera, Rig
from tests.core.truth import Arm, Body, ur10

Floats = NDArray[np.float64]

HOME = np.array([0.3, -1.4, 1.6, -0.3, 0.9, 0.2])
ERRORS = {
    "theta_offset_2": 3e-3, "theta_offset_3": -4e-3, "theta_offset_4": 5e-3, "theta_offset_5": -3e-3, "a_2": 8e-4,
    "a_3": -6e-4, "d_4": 4e-4, "d_5": -3e-4, "alpha_4": 1.5e-3, "alpha_2": -8e-4,
}  # fmt: skip
SOFT = np.array([0.0, 2e-5, 3e-5, 0.0, 0.0, 0.0])  # rad/(N m)
BROWN = (-0.11, 0.07, 0.0006, -0.0004, -0.01)


def grid(columns: int = 8, rows: int = 6, pitch: float = 0.03) -> Floats:
    """Corners of a flat board (columns x rows, 3) m."""
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    return np.column_stack([pitch * x.ravel(), pitch * y.ravel(), np.zeros(columns * rows)])


def drawn_pixels(points: Floats, focal: Floats, centre: Floats, distortion: tuple[float, ...] = ()) -> Floats:
    """Pinhole with Brown's distortion, written out: pixels (..., 2) of points (..., 3) before the camera."""
    k1, k2, p1, p2, k3 = (*distortion, *(0.0,) * (5 - len(distortion)))
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([focal[0] * u + centre[0], focal[1] * v + centre[1]], axis=-1)


@dataclass(frozen=True)
class Eye:
    """A true camera: where it stands (SE3, in the room or on the tool) and how it draws."""

    name: str
    mount: str
    pose: Any
    focal: Floats = field(default_factory=lambda: np.array([1500.0, 1502.0]))
    centre: Floats = field(default_factory=lambda: np.array([962.3, 537.8]))
    size: tuple[int, int] = (1920, 1080)
    distortion: tuple[float, ...] = BROWN

    def described(self, **changes: Any) -> Camera:
        return replace(
            Camera(
                self.name, self.mount, self.size, tuple(self.focal), tuple(self.centre),
                "brown" if self.distortion else "none", self.distortion,
            ),
            **changes,
        )  # fmt: skip


@dataclass(frozen=True)
class Sheet:
    """A true board: where it stands (SE3), its corners, and the scale by which it was printed too large."""

    name: str
    mount: str
    pose: Any
    corners: Floats = field(default_factory=grid)
    scale: float = 0.0

    def described(self, **changes: Any) -> Board:
        return replace(Board(self.name, self.mount, tuple(map(tuple, self.corners.tolist()))), **changes)


def soft(masses: bool = True) -> Arm:
    """A UR10 with masses."""
    kg, places = (7.8, 12.9, 3.9, 2.0, 2.0, 0.4), ((0, 0, 0), (-0.3, 0, 0.14), (-0.28, 0, 0.05), *[(0, 0, 0)] * 3)
    bodies = tuple(Body(j, m, np.array(c, dtype=float)) for j, (m, c) in enumerate(zip(kg, places, strict=True)))
    return ur10(bodies=bodies if masses else (), tool=pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.06])))


@dataclass(frozen=True)
class Scene:
    """An arm as drawn and as built, with what looks and is looked at."""

    drawn: Arm
    built: Arm
    eyes: tuple[Eye, ...]
    sheets: tuple[Sheet, ...]
    yielding: Floats = field(default_factory=lambda: np.zeros(6))

    def tools(self, q: Floats) -> tuple[Floats, Floats]:
        """True tool poses, (N, 3) and (N, 3, 3)."""
        if self.yielding.any():
            q = q - self.yielding * self.drawn.torques(q)
        return self.built.poses(q)

    def in_camera(self, q: Floats, eye: Eye, sheet: Sheet) -> Floats:
        """Corners (N, M, 3) m in the camera's frame."""
        p, R = self.tools(q)
        corners = (1.0 + sheet.scale) * sheet.corners
        on = corners @ sheet.pose.rotation.T + sheet.pose.translation
        if eye.mount == "fixed":
            room = np.einsum("nij,mj->nmi", R, on) + p[:, None]
            return (room - eye.pose.translation) @ eye.pose.rotation
        tool = np.einsum("nji,nmj->nmi", R, on - p[:, None])
        return (tool - eye.pose.translation) @ eye.pose.rotation

    def pixels(self, q: Floats, eye: Eye, sheet: Sheet) -> Floats:
        """Exact pixels (N, M, 2), NaN outside the picture, behind the camera and where the board shows its back."""
        points = self.in_camera(q, eye, sheet)
        flat = drawn_pixels(points, eye.focal, eye.centre, eye.distortion)
        inside = (flat > 2).all(axis=2) & (flat < np.array(eye.size) - 3).all(axis=2) & (points[..., 2] > 0.1)
        across = np.cross(points[:, 1] - points[:, 0], points[:, -1] - points[:, 0])
        view = points.mean(axis=1)
        cosine = np.sum(across * view, axis=1) / np.linalg.norm(across, axis=1) / np.linalg.norm(view, axis=1)
        return np.where((inside & (cosine > 0.5)[:, None])[..., None], flat, np.nan)

    def rig(self, cameras: dict[str, Any] | None = None, boards: dict[str, Any] | None = None) -> Rig:
        """Cameras and boards as described, with changes for all of them."""
        return Rig(
            tuple(e.described(**(cameras or {})) for e in self.eyes),
            tuple(s.described(**(boards or {})) for s in self.sheets),
        )

    def poses(self, count: int, rng: np.random.Generator, fewest: int = 20, spread: float = 0.9) -> Floats:
        """Joint vectors (count, 6) in which each camera sees ``fewest`` corners or more of its board."""
        kept: list[Floats] = []
        while len(kept) < count:
            q = HOME + rng.uniform(-spread, spread, (400, 6))
            ok = np.ones(len(q), dtype=bool)
            for eye in self.eyes:
                seen = [
                    (~np.isnan(self.pixels(q, eye, s)[..., 0])).sum(axis=1) for s in self.sheets if s.mount != eye.mount
                ]
                ok &= np.max(seen, axis=0) >= fewest
            kept += list(q[ok])
        return np.array(kept[:count])

    def observed(
        self, q: Floats, rng: np.random.Generator, noise_px: float = 0.1, rig: Rig | None = None
    ) -> Observations:
        """Views of all cameras of all boards they see, a row each."""
        rig = rig or self.rig()
        rows, pixels, camera, board = [], [], [], []
        most = rig.most_corners
        for c, eye in enumerate(self.eyes):
            for b, sheet in enumerate(self.sheets):
                if sheet.mount == eye.mount:
                    continue
                seen = self.pixels(q, eye, sheet)
                seen += noise_px * rng.standard_normal(seen.shape)
                wide = np.full((len(q), most, 2), np.nan)
                wide[:, : seen.shape[1]] = seen
                rows.append(np.arange(len(q)))
                pixels.append(wide)
                camera.append(np.full(len(q), c))
                board.append(np.full(len(q), b))
        of, made = np.concatenate(rows), np.concatenate(pixels)
        some = (~np.isnan(made[..., 0])).sum(axis=1) >= 6
        order = np.argsort(of[some], kind="stable")
        return Observations(
            q[of[some]][order], pixels=made[some][order], camera=np.concatenate(camera)[some][order],
            board=np.concatenate(board)[some][order], rig=rig, pose_id=of[some][order],
        )  # fmt: skip


def looking(at: Floats, distance: float, towards: Floats) -> Any:
    """A camera's pose that looks along ``towards`` at a point that is ``distance`` away, its x level."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return pin.SE3(np.column_stack([x, np.cross(z, x), z]), at - distance * z)


def eye_to_hand(errors: dict[str, float] | None = None, yielding: Floats | None = None, scale: float = 0.0) -> Scene:
    """One camera in the room, 1 m from where the board on the flange moves."""
    drawn = soft()
    built = drawn.moved(ERRORS if errors is None else errors)
    p, R = drawn.poses(HOME[None])
    eye = Eye("cell", "fixed", looking(p[0], 1.0, -(R[0] @ [0.1, 0.15, 1.0])))
    below = pin.SE3(pin.exp3(np.array([np.pi, 0.0, 0.0])), np.array([-0.1, 0.08, 0.02]))
    sheet = Sheet("board", "flange", below * pin.SE3(pin.exp3(np.array([0.03, -0.02, 0.2])), np.zeros(3)), scale=scale)
    return Scene(drawn, built, (eye,), (sheet,), SOFT if yielding is None else yielding)


def eye_in_hand(errors: dict[str, float] | None = None, yielding: Floats | None = None) -> Scene:
    """A camera on the flange, and a board in the room about 0.7 m before it."""
    drawn = soft()
    built = drawn.moved(ERRORS if errors is None else errors)
    p, R = drawn.poses(HOME[None])
    eye = Eye("hand", "flange", pin.SE3(pin.exp3(np.array([0.05, -0.04, 0.7])), np.array([0.05, 0.02, 0.01])))
    ahead = pin.SE3(R[0], p[0]) * eye.pose
    sheet = Sheet("wall", "fixed", ahead * pin.SE3(pin.exp3(np.array([0.1, 0.1, 0.0])), np.array([-0.1, -0.07, 0.7])))
    return Scene(drawn, built, (eye,), (sheet,), SOFT if yielding is None else yielding)
