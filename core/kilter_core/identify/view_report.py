"""What a result says of its views: their cameras and boards, how noisy corners are, and how far off the tool is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.moved_apart import Apart
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.plausibility.moved_parts import Found, camera_moved
from kilter_core.identify.plausibility.views.astray_views import astray, astray_views
from kilter_core.identify.plausibility.views.unrelated_views import shuffled_control
from kilter_core.identify.plausibility.views.view_residuals import ViewResiduals
from kilter_core.identify.scale_gauge import contradicted_scale
from kilter_core.identify.uncertainty.by_views import by_views, predictive_of_views, rig_sigmas, view_scatter
from kilter_core.identify.uncertainty.clustered import with_clustered_covariance
from kilter_core.identify.uncertainty.held_arm import by_held_arm, holds_arm
from kilter_core.identify.uncertainty.left_open import left_open
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.identify.uncertainty.stated_noise import BeyondNoise
from kilter_core.identify.views.camera_report import cameras_document, pixels_document, tool_document
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.view_scatter import ToolErrors, ViewScatter
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Ints


def with_own_scatter(fit: Fit) -> tuple[Fit, ViewScatter | None]:
    """The fit with the covariance that its poses support, or its views where nothing else was measured of the tool."""
    if not fit.problem.measurement.tool.places_itself:
        return with_clustered_covariance(fit), None
    found = view_scatter(fit)
    return by_held_arm(fit, found) if holds_arm(fit) else by_views(fit, found), found


def predictive_from_views_only(fit: Fit, found: ViewScatter | None) -> Predictive | None:
    """What is known of the tool from views alone; None where there is a tracker."""
    return None if found is None else predictive_of_views(fit, found)


def views_document(calibration: Calibration, fit: Fit, found: ViewScatter | None) -> dict[str, Any]:
    """Cameras and boards of a result and, from views alone, ``pixels``; empty where no camera measured."""
    if fit.problem.measurement.pixels is None:
        return {}
    said = cameras_document(calibration, rig_sigmas(fit))
    if found is None:
        return said
    open_ = left_open(calibration, predictive_of_views(fit, found), fit.problem.measurement.observations)
    return {**said, "pixels": pixels_document(found, open_.rms, open_.high)}


WRONG_VIEWS = ("views_astray", "camera_moved", "board_scale_differs")  # codes of warnings of :func:`wrong_views`
TOO_LARGE_MM = 1.0  # an arm that is off by more picks and places, and assembles nothing
LITTLE = 0.5  # share of the registered nominal robot's error, beyond which a version is hardly worth it
BEYOND_SHOWN = 1.25  # as much more left open than held-out views show is worth a warning
LACKING = 1.5  # variance between views over that of their corners, beyond which the model lacks something


def too_large_to_deploy(said: dict[str, Any], registered_mm: float | None) -> Iterator[dict[str, Any]]:
    """Warn of a fit that ended well and whose tool, on views held out, is too far off to be corrected with."""
    held = (said.get("pixels") or {}).get("validation")
    if held is None:
        return
    little = registered_mm is not None and held["high_mm"] > LITTLE * registered_mm
    if held["high_mm"] <= TOO_LARGE_MM and not little:
        return
    between = said["pixels"]["between_views"]
    state = "The calibration is complete" if between <= LACKING else (
        f"Views scatter {between:.2g} times as much as their corners explain, so the model lacks something"
    )  # fmt: skip
    reason = "" if registered_mm is None or not little else f", and cameras placed alone leave {registered_mm:.3g} mm"
    yield {
        "code": "too_large_to_deploy", "rms_mm": held["rms_mm"], "high_mm": held["high_mm"],
        "message": f"{state}, but the error is too large to deploy: on views held out the tool is off by "
        f"{held['rms_mm']:.3g} mm (95 %: up to {held['high_mm']:.3g} mm){reason}. Take more and sharper views that fill the "
        "picture, add points of a tracker, or look for what is missing with `kilter gap`.",
    }  # fmt: skip


def tell_less(
    said: Mapping[str, Any], held_mm: float | None, seen: str = "By views held out"
) -> Iterator[dict[str, Any]]:
    """Warn where a fit to views leaves more open than views show, ``held_mm`` rms, which were ``seen`` apart from it."""
    left = (said.get("pixels") or {}).get("left_open")
    if left is None or held_mm is None or left["rms_mm"] <= BEYOND_SHOWN * held_mm:
        return
    yield {
        "code": "views_tell_less", "rms_mm": left["rms_mm"], "high_mm": left["high_mm"],
        "message": f"{seen} the tool is off by {held_mm:.3g} mm rms, but the views that were fitted leave more open: "
        f"{left['rms_mm']:.3g} mm rms, up to {left['high_mm']:.3g} mm (95 %), most of it along the lines of sight and in how "
        "large everything is. Take views from nearer, or of a larger board, or measure a length: two points of known distance, "
        "sockets, a few points of a tracker.",
    }  # fmt: skip


def with_control(said: dict[str, Any], begin: Calibration, train: Observations) -> dict[str, Any]:
    """The same with what shuffled joints leave, where views alone were fitted."""
    if "pixels" not in said:
        return said
    return {**said, "pixels": {**said["pixels"], **shuffled_control(begin, train)}}


def held_views(identified: Calibration, held: Observations, train: Measurement) -> ToolErrors | None:
    """Motions of the tool that explain views that were not fitted; None without views."""
    views = Measurement.from_observations(held, held=True, anchor=train).pixels
    return None if views is None else views.tool_errors(identified)


def with_validation_views(said: dict[str, Any], held: ToolErrors | None) -> dict[str, Any]:
    """The same with how far off the tool is in views that were not fitted, where there are such."""
    if "pixels" not in said or held is None:
        return said
    return {**said, "pixels": {**said["pixels"], "validation": tool_document(held.scatter())}}


def wrong_views(
    fit: Fit, begin: Calibration, options: IdentifyOptions, inside: Ints | None
) -> Iterator[dict[str, Any]]:
    """Warnings of a fit to views alone: rows that are not of their joints, what moved half-way, a board of another size.

    ``inside (N,)`` are the numbers of the fitted rows among the ones given; all when None.
    """
    seen, train = ViewResiduals.from_fit(fit), fit.problem.measurement.observations
    if seen is None:
        return
    numbers = np.arange(len(train)) if inside is None else inside
    far = astray(seen)
    yield from astray_views(seen, far, numbers)
    found = Found.from_fit(fit, seen.only(np.flatnonzero(~far)))
    if found is not None:
        apart = Apart.fit_moved_part(begin, train, options, found.best, found.later(len(train)))
        moved = None if apart is None else apart.estimate_motion()
        if moved is None or moved.clear:
            yield camera_moved(found, moved, numbers)
    yield from contradicted_scale(fit)


def wrong(
    fit: Fit, begin: Calibration, options: IdentifyOptions, inside: Ints | None, beyond: BeyondNoise | None
) -> tuple[dict[str, Any], ...]:
    """Warnings of rows that leave more than their noise, and of views that are wrong."""
    more = () if beyond is None else (beyond.warning(inside),)
    return (*more, *wrong_views(fit, begin, options, inside))
