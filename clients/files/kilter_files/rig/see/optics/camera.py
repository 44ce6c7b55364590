"""A camera: from directions to pixels, as OpenCV's models state it."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault

MODELS: dict[str, tuple[int, ...]] = {"none": (0,), "brown": (4, 5), "rational": (8,), "fisheye": (4,)}
ORDER = {"brown": "k1 k2 p1 p2 k3", "rational": "k1 k2 p1 p2 k3 k4 k5 k6", "fisheye": "k1 k2 k3 k4", "none": ""}
REMEDY = "Take the camera.json that kilter measure see wrote, or a file of ROS, Kalibr or OpenCV."
KNOWN = ("fixed", "prior", "free")
SIZES = ("width_px", "height_px")
FOCAL = ("fx_px", "fy_px", "cx_px", "cy_px")


@dataclass(frozen=True)
class Camera:
    """Intrinsics in px, the centre of the upper left pixel being (0, 0); ``distortion`` is in OpenCV's order.

    ``sigmas_px`` are the standard deviations of focal lengths, centre and distortion. A fit takes them as ``known``: fixed,
    prior (within their standard deviations) or free.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion_model: str = "none"
    distortion: tuple[float, ...] = ()
    name: str = "camera"
    sigmas_px: tuple[float, ...] = ()
    known: str = "fixed"

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.width_px, self.height_px

    def to_document(self) -> dict[str, Any]:
        """Return the camera as a campaign names it, without its mount."""
        document: dict[str, Any] = {"name": self.name}
        document |= {name: getattr(self, name) for name in (*SIZES, *FOCAL, "distortion_model")}
        document["distortion"] = list(self.distortion)
        document["intrinsics"] = self.known
        return document | ({"sigmas_px": list(self.sigmas_px)} if self.sigmas_px else {})


def checked_camera(path: Path, document: dict[str, Any]) -> Camera:
    """Return the camera that a document describes.

    Raises:
        FileError: a field is missing, no finite number, or no size of a camera.

    """
    numbers = {name: _number(path, document, name) for name in (*SIZES, *FOCAL)}
    width, height = (int(numbers[name]) for name in SIZES)
    if not (32 <= width <= 65535 and 32 <= height <= 65535):
        raise fault(path, f"states a picture of {width} x {height} px", REMEDY)
    if min(numbers["fx_px"], numbers["fy_px"]) < 0.05 * max(width, height):
        raise fault(path, f"fx_px {numbers['fx_px']:g} is not a focal length in px of such a picture", REMEDY)
    for name, side in (("cx_px", width), ("cy_px", height)):
        if not -side < numbers[name] < 2 * side:
            raise fault(path, f"{name} {numbers[name]:g} is far outside the picture", REMEDY)
    model = document.get("distortion_model", "none")
    given = document.get("distortion") or []
    if model not in MODELS:
        raise fault(path, f"distortion_model {model!r} is none of {', '.join(MODELS)}", REMEDY)
    if not isinstance(given, list) or not all(_is_number(value) for value in given):
        raise fault(path, "distortion is not a list of numbers", REMEDY)
    if len(given) not in MODELS[model]:
        counts = " or ".join(map(str, MODELS[model]))
        raise fault(path, f"has {len(given)} numbers of distortion, and {model} takes {counts}: {ORDER[model]}", REMEDY)
    whole = [float(value) for value in given]
    padded = (*whole, 0.0) if model == "brown" and len(whole) == 4 else tuple(whole)
    name = str(document.get("name") or "camera")
    fx, fy, cx, cy = (numbers[key] for key in FOCAL)
    sigmas = tuple(float(value) for value in document.get("sigmas_px") or () if _is_number(value) and value > 0)
    told = len(sigmas) == 4 + len(padded) == 4 + len(whole)
    known = str(document.get("intrinsics") or ("prior" if told else "fixed"))
    if known not in KNOWN or (known == "prior" and not told):
        raise fault(path, f"intrinsics is {known!r} with {len(sigmas)} sigmas_px", REMEDY)
    return Camera(width, height, fx, fy, cx, cy, model, padded, name, sigmas if told else (), known)


def read_own(path: Path, text: str) -> Camera:
    """Read the JSON that ``kilter measure see`` writes: a camera, or a document with one under ``cameras``.

    Raises:
        FileError: it is another JSON.

    """
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise fault(path, f"is not JSON: {str(error)[:120]}", REMEDY) from error
    listed = document.get("cameras") if isinstance(document, dict) else None
    if isinstance(listed, list):
        if len(listed) != 1 or not isinstance(listed[0], dict):
            raise fault(path, f"has {len(listed)} cameras", "Give the file of one camera.")
        document = listed[0]
    if not isinstance(document, dict):
        raise fault(path, "is not a JSON object", REMEDY)
    return checked_camera(path, document)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _number(path: Path, document: dict[str, Any], name: str) -> float:
    value = document.get(name)
    if not _is_number(value):
        raise fault(path, f"{name} is {'missing' if value is None else f'{value!r}, not a number'}", REMEDY)
    return float(value)  # type: ignore[arg-type]


FREE = {model: max(counts) for model, counts in MODELS.items()}  # numbers of each model


def project_points(points: Floats, intrinsics: Floats, model: str) -> Floats:
    """Pixels (..., 2) of points (..., 3) in the camera's frame; ``intrinsics`` are fx, fy, cx, cy and the lens."""
    z = np.where(np.abs(points[..., 2]) < 1e-9, 1e-9, points[..., 2])
    x, y = points[..., 0] / z, points[..., 1] / z
    x, y = _fisheye(x, y, intrinsics[4:]) if model == "fisheye" else _brown(x, y, intrinsics[4:])
    fx, fy, cx, cy = intrinsics[:4]
    return np.stack([fx * x + cx, fy * y + cy], axis=-1)


def _brown(x: Floats, y: Floats, lens: Floats) -> tuple[Floats, Floats]:
    k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([lens, np.zeros(8 - len(lens))])
    r2 = x**2 + y**2
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
    )


def _fisheye(x: Floats, y: Floats, lens: Floats) -> tuple[Floats, Floats]:
    r = np.maximum(np.hypot(x, y), 1e-12)
    angle = np.arctan(r)
    k1, k2, k3, k4 = lens
    a2 = angle**2
    scale = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))) / r
    return x * scale, y * scale
