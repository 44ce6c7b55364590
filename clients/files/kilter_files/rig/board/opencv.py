"""OpenCV, of a release whose corners are where they should be."""

from __future__ import annotations

from typing import Any

from kilter_files.ground.errors import MissingPackageError
from kilter_files.ground.later import need

OLDEST = (4, 14)
INSTALL = "'opencv-python-headless>=4.14.0.94'"


def opencv() -> Any:
    """Return OpenCV.

    Raises:
        MissingPackageError: it is not installed, or too old.

    """
    cv2 = need("Boards need", "OpenCV", "cv2", install=INSTALL)
    check_release(cv2.__version__)
    return cv2


def dictionary(name: str) -> tuple[Any, Any]:
    """Return OpenCV and the dictionary of a name such as ``5x5_1000``.

    Raises:
        MissingPackageError: OpenCV is not installed, or too old.

    """
    cv2 = opencv()
    spelled = name.removeprefix("apriltag_") if name.startswith("apriltag_") else name.upper()
    prefix = "DICT_APRILTAG_" if name.startswith("apriltag_") else "DICT_"
    return cv2, cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, prefix + spelled))


def check_release(version: str) -> None:
    """Refuse the releases whose ChArUco corners are half a pixel off.

    Raises:
        MissingPackageError: the release is older than 4.14.

    """
    if tuple(int(part) for part in version.split(".")[:2]) < OLDEST:
        raise MissingPackageError(
            f"OpenCV {version} is too old: ChArUco corners of releases before 4.14 are shifted by half a pixel, "
            f"which moves a camera by half a millimetre and shows in no residual. Install a newer one: pip install {INSTALL}",
            package="opencv",
        )
