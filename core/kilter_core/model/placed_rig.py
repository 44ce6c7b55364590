"""Where cameras and boards stand, and which numbers of them are unknown: six of each place, intrinsics, and scales."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from kilter_core.arm.chain import frame_parameters, increment
from kilter_core.observations.rig import Camera, Rig
from kilter_core.parameters import Parameter
from kilter_core.transforms import rotation_along
from kilter_core.types import Floats

FREE_FOCAL = 0.1  # share of the focal length, of free intrinsics
FREE_CENTRE = 0.1  # share of the width
FREE_DISTORTION = 0.5


@dataclass(frozen=True)
class Unknown:
    """One number of a rig: of the camera or board ``part`` at ``place``, "pose" 0-5, "intrinsics" or "scale"."""

    camera: bool
    place: int
    what: str
    index: int


@dataclass(frozen=True, eq=False)
class Place:
    """A part with its numbers: ``origin (4, 4)`` and increments ``six (6,)`` about it, in its own axes.

    A fixed part stands in the frame of the measurements, one on the flange in the frame of the tool.
    """

    origin: Floats
    six: Floats
    values: Floats  # intrinsics of a camera, the relative scale error (1,) of a board

    @property
    def pose(self) -> Floats:
        """Pose (4, 4) of the part."""
        return np.asarray(self.origin @ increment(self.six))

    @property
    def spin(self) -> Floats:
        """Columns (3, 3): how it rotates, in its own axes, with each of its three angles."""
        _, ry, rz = (rotation_along(k, self.six[3 + k]) for k in range(3))
        return np.column_stack([rz.T @ ry.T[:, 0], rz.T[:, 1], np.eye(3)[:, 2]])

    @property
    def twist(self) -> Floats:
        """Columns (6, 6): how it moves (v, w), in its own axes as they stand, with each of its six increments."""
        out = np.zeros((6, 6))
        out[:3, :3] = self.pose[:3, :3].T @ self.origin[:3, :3]
        out[3:, 3:] = self.spin
        return out


@dataclass(frozen=True, eq=False)
class PlacedRig:
    """A rig whose cameras and boards stand at poses (4, 4), with intrinsics and scales (relative errors) as found."""

    rig: Rig
    cameras: tuple[Place, ...]
    boards: tuple[Place, ...]

    @staticmethod
    def at_poses(rig: Rig, cameras: Mapping[int, Floats], boards: Mapping[int, Floats]) -> PlacedRig:
        """Parts at these poses, as they are described; where none is given, at the origin."""

        def make_place(poses: Mapping[int, Floats], k: int, values: Any) -> Place:
            return Place(np.asarray(poses.get(k, np.eye(4))), np.zeros(6), np.array(values, dtype=np.float64))

        return PlacedRig(
            rig,
            tuple(make_place(cameras, k, c.values) for k, c in enumerate(rig.cameras)),
            tuple(make_place(boards, k, (0.0,)) for k in range(len(rig.boards))),
        )

    @cached_property
    def unknowns(self) -> tuple[tuple[Unknown, Parameter], ...]:
        """What a fit may change, with names, units and priors; increments begin at zero, intrinsics at what is stated."""
        out: list[tuple[Unknown, Parameter]] = []
        for k, camera in enumerate(self.rig.cameras):
            out += _pose_unknowns("camera", camera.name, True, k)
            sigmas = _sigmas(camera)
            for i, (name, value) in enumerate(zip(camera.names, camera.values, strict=True) if sigmas else ()):
                unit = "px" if i < 4 else "1"
                parameter = Parameter(f"camera_{camera.name}_{name}", unit, value, sigmas[i])
                out.append((Unknown(True, k, "intrinsics", i), parameter))
        for k, board in enumerate(self.rig.boards):
            out += _pose_unknowns("board", board.name, False, k)
            if board.scale_sigma > 0.0:
                parameter = Parameter(f"board_{board.name}_scale", "1", 0.0, board.scale_sigma)
                out.append((Unknown(False, k, "scale", 0), parameter))
        return tuple(out)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of :attr:`unknowns`."""
        return tuple(parameter for _, parameter in self.unknowns)

    @property
    def values(self) -> Floats:
        """Values (K,) of the unknowns now."""
        return np.array([self._number(u) for u, _ in self.unknowns])

    def _number(self, u: Unknown) -> float:
        place = (self.cameras if u.camera else self.boards)[u.place]
        return float(place.six[u.index] if u.what == "pose" else place.values[u.index])

    def with_values(self, values: Floats) -> PlacedRig:
        """The rig with ``values (K,)`` of its unknowns."""
        parts = {True: list(self.cameras), False: list(self.boards)}
        for (u, _), value in zip(self.unknowns, values, strict=True):
            old = parts[u.camera][u.place]
            name = "six" if u.what == "pose" else "values"
            array = getattr(old, name).copy()
            array[u.index] = value
            parts[u.camera][u.place] = replace(old, **{name: array})
        return replace(self, cameras=tuple(parts[True]), boards=tuple(parts[False]))

    def corners(self, k: int) -> Floats:
        """Corners (M, 3) m of a board in its own frame, as large as it was found."""
        return np.asarray((1.0 + self.boards[k].values[0]) * np.array(self.rig.boards[k].corners))

    def with_folded_increments(self) -> PlacedRig:
        """The same, the increments folded into the poses."""
        cameras, boards = (
            tuple(_transform_place(p, np.eye(4)) for p in parts) for parts in (self.cameras, self.boards)
        )
        return replace(self, cameras=cameras, boards=boards)

    def with_description(self, rig: Rig) -> PlacedRig:
        """The same places of cameras and boards that are described otherwise."""
        return replace(self, rig=rig)

    def has(self, rig: Rig) -> bool:
        """Whether it knows where all parts of ``rig`` stand."""
        cameras, boards = {c.name for c in self.rig.cameras}, {b.name for b in self.rig.boards}
        return {c.name for c in rig.cameras} <= cameras and {b.name for b in rig.boards} <= boards

    def select_parts(self, rig: Rig) -> PlacedRig:
        """The places of ``rig``'s parts, by their names, with the intrinsics and scales that were found here."""
        cameras = [self.cameras[[c.name for c in self.rig.cameras].index(one.name)] for one in rig.cameras]
        boards = [self.boards[[b.name for b in self.rig.boards].index(one.name)] for one in rig.boards]
        return PlacedRig(rig, tuple(cameras), tuple(boards))

    def transform_frames(self, base: Floats | None = None, tool: Floats | None = None) -> PlacedRig:
        """The rig seen in other frames (4, 4): ``base`` takes the old room into the new one, ``tool`` the old tool."""

        by = {"fixed": base, "flange": tool}
        cameras = [_transform_place(p, by[c.mount]) for p, c in zip(self.cameras, self.rig.cameras, strict=True)]
        boards = [_transform_place(p, by[b.mount]) for p, b in zip(self.boards, self.rig.boards, strict=True)]
        return replace(self, cameras=tuple(cameras), boards=tuple(boards))

    def to_document(self) -> dict[str, Any]:
        """JSON-able, SI."""
        own = self.with_folded_increments()
        return {
            **self.rig.to_document(),
            "camera_poses": [p.origin.tolist() for p in own.cameras],
            "camera_values": [p.values.tolist() for p in own.cameras],
            "board_poses": [p.origin.tolist() for p in own.boards],
            "board_scales": [float(p.values[0]) for p in own.boards],
        }

    @staticmethod
    def from_document(document: Mapping[str, Any] | None) -> PlacedRig | None:
        """Rebuild from :meth:`to_document`; None of nothing."""
        if document is None:
            return None
        rig = Rig.from_document({name: document[name] for name in ("cameras", "boards")})

        def place(T: Any, values: Any) -> Place:
            return Place(np.array(T), np.zeros(6), np.array(values, dtype=np.float64))

        cameras = [place(T, v) for T, v in zip(document["camera_poses"], document["camera_values"], strict=True)]
        boards = [place(T, [v]) for T, v in zip(document["board_poses"], document["board_scales"], strict=True)]
        return PlacedRig(rig, tuple(cameras), tuple(boards))


def _transform_place(place: Place, by: Floats | None) -> Place:
    return place if by is None else replace(place, origin=by @ place.pose, six=np.zeros(6))


def _pose_unknowns(what: str, name: str, camera: bool, k: int) -> list[tuple[Unknown, Parameter]]:
    return [(Unknown(camera, k, "pose", i), one) for i, one in enumerate(frame_parameters(f"{what}_{name}"))]


def _sigmas(camera: Camera) -> tuple[float, ...]:
    """Prior standard deviations of the intrinsics, none where they are fixed."""
    if camera.intrinsics == "fixed":
        return ()
    if camera.intrinsics == "prior":
        assert camera.sigmas is not None
        return camera.sigmas
    wide = (*(FREE_FOCAL * f for f in camera.focal), *(FREE_CENTRE * camera.size[0],) * 2)
    return (*wide, *(FREE_DISTORTION,) * len(camera.distortion))
