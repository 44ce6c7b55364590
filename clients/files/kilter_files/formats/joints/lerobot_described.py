"""How LeRobot's files are read, before anything is made of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from kilter_files.formats.joints.described import describe_log
from kilter_files.formats.joints.lerobot.calibration import NORM_MODES, read_calibration
from kilter_files.formats.joints.lerobot.dataset import Dataset, open_dataset, refuse_unfinished
from kilter_files.formats.joints.lerobot.log import arm_joint_names, log_of_dataset, refuse_leader
from kilter_files.formats.reader import Document, LogHints
from kilter_files.ground.errors import FileError


def describe_dataset(path: Path, hints: LogHints) -> Document:
    """Say what a data set holds; with a calibration, read it whole."""
    if hints.calibration is not None or hints.zero == "old":
        return describe_log(log_of_dataset(path, hints))
    dataset = open_dataset(path)
    refuse_unfinished(dataset)
    notes = [
        dataset.summary_text,
        f"joints {', '.join(dataset.names)}",
    ]
    modes = " or ".join(NORM_MODES)
    warnings = [
        f"nothing says what its numbers mean: give --calibration JSON and --norm-mode {modes}",
        *_refusal_messages(dataset, partial(arm_joint_names, dataset, hints.order)),
    ]
    problems = [{"what": text} for text in _refusal_messages(dataset, partial(refuse_leader, dataset))]
    duration_s = dataset.frames / dataset.fps if dataset.fps else None
    return {
        "kind": "joint-log",
        "rows": dataset.frames,
        "rate_hz": dataset.fps,
        "duration_s": duration_s,
        "notes": notes,
        "warnings": warnings,
        "problems": problems,
    }


def _refusal_messages(dataset: Dataset, check: Callable[[], object]) -> list[str]:
    """What ``check`` has against a data set, without its name; nothing where it passes."""
    try:
        check()
    except FileError as error:
        return [error.detail.removeprefix(f"{dataset.folder}: ").rstrip(".")]
    return []


def describe_calibration(path: Path) -> Document:
    """Say what a calibration holds."""
    found = read_calibration(path)
    notes = [
        f"SHA-256 {found.sha256}",
        "of a leader" if found.of_a_leader else "of a follower, or of neither by its folder",
    ]
    for name, servo in found.servos.items():
        reversed_ = ", reversed" if servo.drive_mode else ""
        notes.append(
            f"servo {servo.id} {name}: homing offset {servo.homing_offset} ticks, range {servo.range_min} to "
            f"{servo.range_max} (+-{servo.half_range_deg:.1f} deg){reversed_}"
        )
    return {"notes": notes, "warnings": found.seam_warnings()}
