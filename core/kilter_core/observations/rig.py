"""Cameras and boards that a campaign was measured with, as they are described; where they stand is for a fit to find."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

from kilter_core.errors import ObservationError

# Distortion models, with how many numbers of OpenCV's order each has.
DISTORTIONS: dict[str, tuple[int, ...]] = {"none": (0,), "brown": (4, 5), "rational": (8,), "fisheye": (4,)}
INTRINSICS = ("fixed", "prior", "free")
MOUNTS = ("fixed", "flange")
FEWEST_CORNERS = 4


@dataclass(frozen=True)
class Camera:
    """A camera: ``focal`` and ``centre`` px, the centre of the top left pixel being (0, 0), and its ``distortion``.

    ``mount`` "fixed" (in the room) or "flange". ``intrinsics`` "fixed", "prior" (``sigmas``, in the order fx, fy, cx, cy,
    distortion, say how well they are known) or "free".
    """

    name: str
    mount: str
    size: tuple[int, int]
    focal: tuple[float, float]
    centre: tuple[float, float]
    model: str = "none"
    distortion: tuple[float, ...] = ()
    intrinsics: str = "fixed"
    sigmas: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.mount not in MOUNTS:
            raise _invalid_part_error("camera", self.name, f"mount is {self.mount!r}: give {' or '.join(MOUNTS)}.")
        if self.model not in DISTORTIONS:
            raise _invalid_part_error(
                "camera", self.name, f"distortion_model is {self.model!r}: give {', '.join(DISTORTIONS)}."
            )
        counts = DISTORTIONS[self.model]
        if len(self.distortion) not in counts:
            wanted = " or ".join(map(str, counts))
            raise _invalid_part_error(
                "camera", self.name, f"distortion has {len(self.distortion)} numbers, {self.model} has {wanted}."
            )
        if self.intrinsics not in INTRINSICS:
            raise _invalid_part_error(
                "camera", self.name, f"intrinsics is {self.intrinsics!r}: give {', '.join(INTRINSICS)}."
            )
        if self.intrinsics == "prior" and (self.sigmas is None or len(self.sigmas) != 4 + len(self.distortion)):
            raise _invalid_part_error(
                "camera",
                self.name,
                f"intrinsics prior needs sigmas_px with {4 + len(self.distortion)} numbers: fx, fy, cx, cy and the distortion.",
            )
        if min(*self.focal, *self.size) <= 0:
            raise _invalid_part_error(
                "camera", self.name, "focal length and size must be above 0: give them in pixels."
            )

    @property
    def values(self) -> tuple[float, ...]:
        """Intrinsics in their order: fx, fy, cx, cy, distortion."""
        return (*self.focal, *self.centre, *self.distortion)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the intrinsics."""
        radial = {"brown": ("k1", "k2", "p1", "p2", "k3"), "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")}
        own = radial.get(self.model, ("k1", "k2", "k3", "k4"))
        return ("fx", "fy", "cx", "cy", *own[: len(self.distortion)])


@dataclass(frozen=True)
class Board:
    """A board whose ``corners`` m stand in a frame of its own. ``scale_sigma``: how well its scale is known, 0: exactly."""

    name: str
    mount: str
    corners: tuple[tuple[float, float, float], ...]
    scale_sigma: float = 0.0

    def __post_init__(self) -> None:
        if self.mount not in MOUNTS:
            raise _invalid_part_error("board", self.name, f"mount is {self.mount!r}: give {' or '.join(MOUNTS)}.")
        if len(self.corners) < FEWEST_CORNERS:
            raise _invalid_part_error(
                "board", self.name, f"{len(self.corners)} corners are too few: give {FEWEST_CORNERS} or more."
            )
        if not self.scale_sigma >= 0.0:
            raise _invalid_part_error(
                "board", self.name, "the sigma of its scale must be 0 or more: it is a standard deviation."
            )


def format_part_name(what: str, name: str) -> str:
    """A camera or board in a sentence: *camera head*, and *the camera* where that is its name."""
    return f"the {what}" if name == what else f"{what} {name}"


def _invalid_part_error(what: str, name: str, why: str) -> ObservationError:
    return ObservationError(f"{what.capitalize()} {name!r}: {why}", code=f"{what}_invalid", **{what: name})


Part = TypeVar("Part", Camera, Board)


@dataclass(frozen=True)
class Rig:
    """The cameras and boards of rows, which name them by their places here."""

    cameras: tuple[Camera, ...]
    boards: tuple[Board, ...]

    def __post_init__(self) -> None:
        for what, parts in (("camera", self.cameras), ("board", self.boards)):
            names = [part.name for part in parts]
            for name in names:
                if names.count(name) > 1:
                    raise _invalid_part_error(what, name, "two have this name: give each its own.")

    @property
    def most_corners(self) -> int:
        """Corners of the largest board."""
        return max(len(board.corners) for board in self.boards)

    def with_fixed_parameters(self) -> Rig:
        """The same with intrinsics and scales that count as exact."""
        cameras = tuple(replace(c, intrinsics="fixed", sigmas=None) for c in self.cameras)
        return Rig(cameras, tuple(replace(b, scale_sigma=0.0) for b in self.boards))

    @staticmethod
    def from_rigs(rigs: Iterable[Rig]) -> Rig:
        """All cameras and boards of several campaigns; one name stands for one camera, and one place of it."""
        cameras: dict[str, Camera] = {}
        boards: dict[str, Board] = {}
        for rig in rigs:
            for camera in rig.cameras:
                _add_part(cameras, camera, "camera")
            for board in rig.boards:
                _add_part(boards, board, "board")
        return Rig(tuple(cameras.values()), tuple(boards.values()))

    def to_document(self) -> dict[str, Any]:
        """JSON-able, SI."""
        return {"cameras": [asdict(c) for c in self.cameras], "boards": [asdict(b) for b in self.boards]}

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Rig:
        """Rebuild from :meth:`to_document`."""
        cameras = [Camera(**{k: _tuples(v) for k, v in c.items()}) for c in document["cameras"]]
        boards = [Board(**{k: _tuples(v) for k, v in b.items()}) for b in document["boards"]]
        return Rig(tuple(cameras), tuple(boards))


def _add_part(known: dict[str, Part], part: Part, what: str) -> None:
    if known.setdefault(part.name, part) != part:
        raise _invalid_part_error(
            what,
            part.name,
            f"campaigns describe it differently. Describe one {what} alike everywhere, or give another its own name.",
        )


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, (list, tuple)) else value
