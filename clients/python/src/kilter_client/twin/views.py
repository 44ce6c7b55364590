"""How far a model of MuJoCo is from views of a board: in pixels, and in millimetres at the tool without the corners' noise.

A view tells the tool's place along its line of sight ten times worse than across it. So what corners scatter by about the pose
that fits their own view is noise, what views scatter by beyond it is the tool's, each as wide as is likeliest (EM), and the
errors of single views are scaled to scatter so. An evaluation by the server says millimetres of views in the same sense.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kilter_client.errors import UsageError
from kilter_files.ground.later import np
from kilter_files.match import rotations
from kilter_files.rig import FEWEST_CORNERS, FEWEST_VIEWS, SeenBoard, find_seen_boards

if TYPE_CHECKING:
    from kilter_files.ground import Floats

STEP_MM, STEP_RAD = 1e-3, 1e-6
ROUNDS = 80
PLACINGS = 6  # of finding how far off the model is, and placing camera and board again
SMALLEST_MM, SMALLEST_RAD = 1e-5, 1e-8
PARTS = slice(0, 3), slice(3, 6)  # of a motion: place and rotation


@dataclass(frozen=True)
class ViewErrors:
    """Errors ``tool`` (K,) m of the tool, ``rms_px`` of all corners, and ``noise_px`` about the pose of each view's own."""

    tool: Floats
    rms_px: float
    noise_px: float


def errors_of_views(
    places: Floats, turns: Floats, views: Sequence[Mapping[str, Any]], rig: Mapping[str, Any]
) -> ViewErrors:
    """Errors of settled tools, ``places`` (N, 3) m and ``turns`` (N, 3, 3), camera and board placed where they fit best.

    ``views`` have ``u1_px``, ``v1_px`` ..., ``rig`` names ``cameras`` and ``boards`` as a campaign does.

    Raises:
        UsageError: no camera and board of which the views tell where they stand.

    """
    tools = np.tile(np.eye(4), (len(places), 1, 1))
    tools[:, :3, :3], tools[:, :3, 3] = turns, 1e3 * places
    found = [_fit_camera_and_board(one.exactly(tools), tools) for one in find_seen_boards(views, tools, rig)]
    if not found:
        raise UsageError(
            f"The views do not say where camera and board stand by this model: {FEWEST_VIEWS} views of {FEWEST_CORNERS} "
            "corners of a flat board, from poses that rotate the tool about more than one axis, and a model that is "
            "roughly this arm do. Check --joints, --site and the conditions cameras and boards of the campaign."
        )
    told = [_fit_tool_motions(one, tools) for one in found]
    motions, covariances = (np.concatenate([one[k] for one in told]) for k in (0, 1))
    rest, corners, square = (sum(one[k] for one in told) for k in (2, 3, 4))
    beyond = corners - 6 * len(motions)
    noise = float(np.sqrt(rest / beyond))
    tool = 1e-3 * np.linalg.norm(_without_noise(motions, noise**2 * covariances)[:, :3], axis=1)
    return ViewErrors(np.asarray(tool), float(np.sqrt(square / corners)), noise)


def _fit_camera_and_board(one: SeenBoard, tools: Floats) -> SeenBoard:
    """Camera and board beside a model that need not be right: each view counts as far as views scatter.

    Corners alone hardly care how far away a board is, and would take a model for several times as far off as it is.
    """
    for _ in range(PLACINGS):
        motion, covariance, rest, corners, _ = _fit_tool_motions(one, tools)
        noise = rest / (corners - 6 * len(motion)) * covariance
        root = np.linalg.inv(np.linalg.cholesky(noise + np.diag(np.repeat(_scatter(motion, noise)[0], 3) ** 2)))
        moves = np.diag([STEP_RAD, STEP_RAD, STEP_RAD, STEP_MM, STEP_MM, STEP_MM] * 2)
        slopes = [(_fit_tool_motions(one.apply_pose_step(move), tools)[0] - motion) / move.sum() for move in moves]
        white = np.einsum("kij,ckj->kic", root, np.array(slopes)).reshape(-1, 12)
        one = one.apply_pose_step(np.linalg.lstsq(white, -np.einsum("kij,kj->ki", root, motion).ravel(), rcond=None)[0])
    return one


def _fit_tool_motions(one: SeenBoard, tools: Floats) -> tuple[Floats, Floats, float, int, float]:
    """Motions (K, 6) mm, rad of the tool that explain what is left of the views, their covariance for corners of 1 px.

    Then px² that they leave, how many numbers the corners are, and px² that were left.
    """
    own = tools[one.views]
    left = one.sight.reprojection_residuals(own, one.pixels)
    slopes = np.stack(
        [(one.sight.reprojection_residuals(_perturb_tools(own, k), one.pixels) - left) / _step(k) for k in range(6)],
        axis=-1,
    )
    shown = np.isfinite(left)
    A = np.where(shown[..., None], slopes, 0.0).reshape(len(own), -1, 6)
    r = np.where(shown, left, 0.0).reshape(len(own), -1)
    C = np.linalg.inv(A.transpose(0, 2, 1) @ A)
    motion = -np.einsum("nij,nkj,nk->ni", C, A, r)
    rest = r + np.einsum("nki,ni->nk", A, motion)
    return motion, C, float(np.sum(rest**2)), int(shown.sum()), float(np.sum(r**2))


def _step(k: int) -> float:
    return STEP_MM if k < 3 else STEP_RAD


def _perturb_tools(tools: Floats, k: int) -> Floats:
    """The tools moved along or rotated about an axis of the base, each about its own place."""
    moved, axis = tools.copy(), np.eye(3)[k % 3]
    if k < 3:
        moved[:, :3, 3] += STEP_MM * axis
    else:
        moved[:, :3, :3] = rotations(STEP_RAD * axis[None])[0] @ tools[:, :3, :3]
    return moved


def _without_noise(motions: Floats, noise: Floats) -> Floats:
    """Motions (K, 6) without their noise (K, 6, 6), that scatter as the tool does."""
    widths, kept = _scatter(motions, noise)
    for part, width in zip(PARTS, widths, strict=True):
        size = float(np.sqrt(np.mean(kept[:, part] ** 2)))
        kept[:, part] *= width / size if size > 0.0 else 1.0
    return np.asarray(kept)


def _scatter(motions: Floats, noise: Floats) -> tuple[list[float], Floats]:
    """Likeliest widths of place and rotation, and the motions (K, 6) as they are then likeliest."""
    precision, least = np.linalg.inv(noise), (SMALLEST_MM, SMALLEST_RAD)
    widths = [max(float(np.sqrt(np.mean(motions[:, part] ** 2))), own) for part, own in zip(PARTS, least, strict=True)]
    pull = precision @ motions[:, :, None]
    for _ in range(ROUNDS):
        P = np.linalg.inv(precision + np.diag(np.repeat(np.array(widths) ** -2.0, 3)))
        kept = (P @ pull)[:, :, 0]
        second = kept**2 + np.diagonal(P, axis1=1, axis2=2)
        widths = [max(float(np.sqrt(second[:, part].mean())), own) for part, own in zip(PARTS, least, strict=True)]
    return widths, np.asarray(kept)
