"""Intrinsics from files of other programs: ROS camera_info, Kalibr, OpenCV; and from Kilter's own JSON."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.later import need, yaml
from kilter_files.rig.see.optics.camera import FOCAL, REMEDY, Camera, checked_camera, read_own

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
