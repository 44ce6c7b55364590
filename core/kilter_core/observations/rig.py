"""Cameras and boards of a campaign, and campaigns that stand in one table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.observations.repeats import numbered_poses

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


Rows: TypeAlias = Any  # Observations, which join themselves by this module

SET_UP = ("session", "setup")  # of a tracker: rows of cameras alone belong to the first
INSTRUMENT = ("position", "markers")  # columns by which an instrument says where the tool was
TOOL = (*INSTRUMENT, "socket", "plane", "bar")  # columns that say where the tool was
CONTACTS = ("socket", "plane", "bar", "bar_length")  # columns that say what held its ball


def with_same_columns(parts: Sequence[Rows]) -> Sequence[Rows]:
    """Return campaigns with the same columns, empty or unknown where one did not measure or state them.

    Campaigns that measured the tool in different ways still differ.
    """
    return _with_same_conditions(_align_columns(_with_one_rig(parts)))


def _align_columns(parts: Sequence[Rows]) -> Sequence[Rows]:
    """Campaigns side by side that measured different things: readings of sensors that others lack are empty there.

    Where one did not measure the tool at all, its place is empty too. Campaigns that measured the tool differently differ.
    """
    parts = _with_contacts(parts)
    for name in ("link_q", "command", "tilt"):
        shapes = [getattr(part, name).shape[1:] for part in parts if getattr(part, name) is not None]
        if shapes:
            parts = [_pad_column(part, name, max(shapes)) for part in parts]  # the longest has the base too
    # Beside views all have the columns of contacts: there an instrument alone says who measured the tool.
    told = TOOL if all(part.pixels is None for part in parts) else INSTRUMENT
    first = next((part for part in parts if _has_any_column(part, told)), None)
    if first is None:
        return parts
    others = [not _has_any_column(part, told) for part in parts]
    for name in ("position", "rotation", "markers"):
        value = getattr(first, name)
        if value is not None:
            parts = [
                _pad_column(part, name, value.shape[1:]) if other else part
                for part, other in zip(parts, others, strict=True)
            ]
    return parts


def _with_same_conditions(parts: Sequence[Rows]) -> Sequence[Rows]:
    """Campaigns of which some do not know from which side joints came, in which session, or when."""
    if any(part.direction is not None for part in parts):
        parts = [p if p.direction is not None else replace(p, direction=np.zeros_like(p.q)) for p in parts]
    if any(part.session is not None for part in parts):
        free = 1 + max(int(part.session.max()) for part in parts if part.session is not None)
        parts = [
            p if p.session is not None else replace(p, session=np.full(len(p), free + k)) for k, p in enumerate(parts)
        ]
    lost: dict[str, Any] = {name: None for name in ("t", "row") if any(getattr(part, name) is None for part in parts)}
    return _with_pose_numbers([replace(part, **lost) for part in parts])


def _with_contacts(parts: Sequence[Rows]) -> Sequence[Rows]:
    """Campaigns beside others whose ball sockets, planes and bars held: nothing held those that measured no place."""
    if all(part.pixels is None for part in parts):
        return parts
    for name in CONTACTS:
        if any(getattr(part, name) is not None for part in parts):
            parts = [_unheld(part, name) for part in parts]
    return parts


def _unheld(part: Rows, name: str) -> Rows:
    if getattr(part, name) is not None:
        return part
    none = np.full(len(part), np.nan) if name == "bar_length" else np.zeros(len(part), dtype=np.int64)
    changes: dict[str, Any] = {name: none}
    return replace(part, **changes)


def _has_any_column(part: Rows, columns: Sequence[str]) -> bool:
    return any(getattr(part, name) is not None for name in columns)


def _pad_column(part: Rows, name: str, shape: tuple[int, ...]) -> Rows:
    """The rows with a column of this shape: empty where it is missing, or where it ends before its last places."""
    own = getattr(part, name)
    if own is not None and own.shape[1:] == shape:
        return part
    out = np.full((len(part), *shape), np.nan)
    if own is not None:
        out[:, : own.shape[1]] = own
    made: dict[str, Any] = {name: out}
    return replace(part, **made)


def _with_one_rig(parts: Sequence[Rows]) -> Sequence[Rows]:
    """Campaigns with all cameras and boards described once; rows that no camera measured have no pixels."""
    if all(part.rig is None for part in parts):
        return parts
    rig = Rig.from_rigs(part.rig for part in parts if part.rig is not None)
    parts = _with_pose_numbers(parts)
    codes = {name: next((c[0] for p in parts if (c := getattr(p, name)) is not None), None) for name in SET_UP}
    return [_with_shared_rig(part, rig, parts, codes) for part in parts]


def _with_pose_numbers(parts: Sequence[Rows]) -> Sequence[Rows]:
    """Campaigns that all number their poses where views do: cameras at one pose share a number, which others lack."""
    if all(part.pose_id is None for part in parts):
        return parts
    out, free = [], 1 + max(int(part.pose_id.max()) for part in parts if part.pose_id is not None)
    for part in parts:
        if part.pose_id is None:
            part = replace(part, pose_id=free + numbered_poses(part.q))
            assert part.pose_id is not None
            free = 1 + int(part.pose_id.max())
        out.append(part)
    return out


def _with_shared_rig(part: Rows, rig: Rig, parts: Sequence[Rows], codes: dict[str, Any]) -> Rows:
    """One of the campaigns with the cameras and boards of all, and of the set-up of the first tracker where it has none."""
    own = part.rig or Rig((), ())
    changes: dict[str, Any] = {"rig": rig}
    for name, before, after in (("camera", own.cameras, rig.cameras), ("board", own.boards, rig.boards)):
        places = np.array([[a.name for a in after].index(b.name) for b in before] + [-1], dtype=np.int64)
        column = getattr(part, name)
        changes[name] = places[np.full(len(part), -1) if column is None else column]
    part = _pad_column(replace(part, **changes), "pixels", (rig.most_corners, 2))
    if any(one.pixel_sigma is not None for one in parts):
        part = _pad_column(part, "pixel_sigma", (rig.most_corners, 2))
    missing: dict[str, Any] = {
        k: np.full(len(part), c) for k, c in codes.items() if c is not None and getattr(part, k) is None
    }
    return replace(part, **missing)
