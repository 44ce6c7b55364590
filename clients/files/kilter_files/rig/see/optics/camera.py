"""A camera: from directions to pixels, as OpenCV's models state it.

Intrinsics from files of other programs: ROS camera_info, Kalibr, OpenCV; and from Kilter's own JSON.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.later import need, yaml

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


MOST_BYTES = 1 << 22
ROS_MODELS = {"plumb_bob": "brown", "rational_polynomial": "rational", "equidistant": "fisheye", "fisheye": "fisheye"}
KALIBR_MODELS = {"radtan": "brown", "equidistant": "fisheye", "none": "none"}
MATRIX_KEYS = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "M1")
LENS_KEYS = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "D", "dist_coeff", "D1")
WIDTH_KEYS, HEIGHT_KEYS = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")


def read_camera(path: Path, name: str | None = None, size: tuple[int, int] | None = None) -> Camera:
    """Read the intrinsics of a camera; ``name`` is which of several, ``size`` that of its pictures if the file has none.

    Raises:
        FileError: none of the formats, a value that is missing, a lens that has another model.
        MissingPackageError: YAML without PyYAML.

    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise fault(path, "is too large for intrinsics", REMEDY)
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}.", file=str(path)) from error
    except UnicodeDecodeError as error:
        raise fault(path, "is not text", REMEDY, byte=error.start) from error
    if text.lstrip().startswith("{"):
        return read_own(path, text)
    document = _xml(path, text) if text.lstrip().startswith("<") else _yaml(path, text)
    if not isinstance(document, dict):
        raise fault(path, "has no camera", REMEDY)
    cameras = {key: one for key, one in document.items() if isinstance(one, dict) and "intrinsics" in one}
    if cameras:
        return _kalibr(path, cameras, name)
    return _matrix(path, document, size)


def _kalibr(path: Path, cameras: dict[str, Any], name: str | None) -> Camera:
    if len(cameras) > 1 and name not in cameras:
        raise fault(path, f"has {', '.join(cameras)}", "Say which one is meant with --camera-name.")
    key = name if name in cameras else next(iter(cameras))
    one = cameras[str(key)]
    if one.get("camera_model", "pinhole") != "pinhole":
        raise fault(path, f"{key} is {one['camera_model']}", "Calibrate it as pinhole with radtan or equidistant.")
    model = KALIBR_MODELS.get(str(one.get("distortion_model", "none")))
    if model is None:
        raise fault(path, f"{key} has the lens {one['distortion_model']}", "Calibrate it with radtan or equidistant.")
    values, resolution = _numbers(one["intrinsics"]), _numbers(one.get("resolution"))
    if len(values) != 4 or len(resolution) != 2:
        raise fault(path, f"{key} lacks four intrinsics or its resolution", REMEDY)
    lens = _numbers(one.get("distortion_coeffs")) if model != "none" else []
    return _build_camera(path, [*resolution, *values], model, lens, str(key))


def _matrix(path: Path, document: dict[str, Any], size: tuple[int, int] | None) -> Camera:
    """ROS and OpenCV: a matrix of nine, and the numbers of the lens."""
    k = _numbers(_first_stated_value(document, MATRIX_KEYS))
    if len(k) != 9:
        raise fault(path, f"has none of {', '.join(MATRIX_KEYS)} with nine numbers", REMEDY)
    if abs(k[1]) > 1e-6 * abs(k[0]):
        raise fault(path, f"its pixels are skewed ({k[1]:g} in the first row)", "Calibrate it without skew.")
    stated = [_first_stated_value(document, keys) for keys in (WIDTH_KEYS, HEIGHT_KEYS)]
    if None in stated:
        if size is None:
            raise fault(path, "does not say how large its pictures are", "Add image_width and image_height.")
        stated = list(size)
    lens = _numbers(_first_stated_value(document, LENS_KEYS))
    said = str(document.get("distortion_model") or ("fisheye" if document.get("fisheye_model") in (1, "1") else ""))
    if said and said not in (*ROS_MODELS, "none"):
        raise fault(path, f"its lens is {said!r}", f"Take one of {', '.join(ROS_MODELS)}.")
    while len(lens) > 5 and not lens[-1] and len(lens) not in (5, 8):
        lens.pop()  # thin prisms and tilts that are nought
    if len(lens) > 8:
        raise fault(path, f"its lens has {len(lens)} numbers", "Calibrate it with 4, 5 or 8: no thin prism, no tilt.")
    model = ROS_MODELS.get(said) or {0: "none", 4: "brown", 5: "brown", 8: "rational"}.get(len(lens), "none")
    if not any(lens) and model != "fisheye":
        model, lens = "none", []
    name = str(document.get("camera_name") or "camera")
    return _build_camera(path, [*_numbers(stated), k[0], k[4], k[2], k[5]], model, lens, name)


def _build_camera(path: Path, values: list[float], model: str, lens: list[float], name: str) -> Camera:
    document = dict(zip(("width_px", "height_px", *FOCAL), values, strict=True))
    return checked_camera(path, document | {"distortion_model": model, "distortion": lens, "name": name})


def _first_stated_value(document: dict[str, Any], keys: tuple[str, ...]) -> Any:
    return next((document[key] for key in keys if document.get(key) is not None), None)


def _numbers(value: Any) -> list[float]:
    """Return the numbers of a list, of nested lists, or of a matrix with ``data``."""
    if isinstance(value, dict):
        value = value.get("data")
    if isinstance(value, str):
        value = value.split()
    found: list[float] = []
    for one in value if isinstance(value, list) else []:
        try:
            found += _numbers(one) if isinstance(one, list) else [float(one)]
        except (TypeError, ValueError):
            return []
    return found


def _yaml(path: Path, text: str) -> Any:
    need(f"{path}: YAML files need", "pyyaml", "yaml")
    plain = re.sub(r"^%YAML.*$", "", text, flags=re.MULTILINE).replace("!!opencv-matrix", "")
    try:
        return yaml.safe_load(plain)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise fault(path, f"is not YAML: {str(error)[:160]}", REMEDY) from error


def _xml(path: Path, text: str) -> dict[str, Any]:
    if "<!" in text.replace("<!--", ""):
        raise fault(path, "has a document type", "Take the file as OpenCV wrote it.")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - without a document type there are no entities
    except ElementTree.ParseError as error:
        raise fault(path, f"is not XML: {error}", REMEDY) from error
    return {part.tag: part.findtext("data") or (part.text or "").strip() for part in root}
