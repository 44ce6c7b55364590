"""``kilter gap --model``: what a simulator's model lacks, by logs of commands and readings; no server takes part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import split_names
from kilter_client.cli.terminal.output import emit, job_bar, print_line, show_rows
from kilter_client.errors import MissingPackageError, UsageError
from kilter_client.files import files_formats
from kilter_files.formats import LogHints
from kilter_files.ground.later import later

with later(__name__):  # it has the core, which a client alone does without
    from kilter_client.twin import servo_gap, simulators

if TYPE_CHECKING:
    from kilter_client.twin.servo_gap import Patched
    from kilter_client.twin.simulators import Rendered

ERRORS = {"stated": "your model", "servo_fitted": "its servos fitted", "found": "with what was found"}


@dataclass(frozen=True)
class ModelSearch:
    """What ``kilter gap --model`` is asked besides its logs."""

    models: Sequence[Path]
    held: Sequence[str]
    joints: Sequence[str] | None
    site: str | None
    payload_body: str
    output: Path | None
    calibration: Path | None
    norm_mode: str | None
    column_map: Path | None
    ranges: Path | None
    ranges_percent: float
    form: str
    servos: str | None
    seed: int | None


def search_models(logs: Sequence[str], asked: ModelSearch, details: bool, as_json: bool) -> None:
    """Search the logs for what each model lacks, print it, and write the copy.

    Raises:
        UsageError: an output with several models, or over the model itself.
        MissingPackageError: the core or MuJoCo is not installed.

    """
    if getattr(find_spec("kilter_core"), "origin", None) is None:
        raise MissingPackageError(
            "kilter gap --model needs the core and MuJoCo: install the wheel of kilter_core, and mujoco.",
            package="kilter-core",
        )
    if (asked.output or asked.ranges) and len(asked.models) > 1:
        raise UsageError("--output and --ranges are of one model: leave them out to compare several.")
    if asked.output is not None and asked.output.resolve() == asked.models[0].resolve():
        raise UsageError(f"{asked.output} is the model itself, which stays as it is: name another file.")
    if asked.form != "mjcf" and asked.output is None:
        raise UsageError(f"--format {asked.form} is of the file that --output names: add -o FILE.")
    if asked.form == "lerobot" and (asked.calibration is None or asked.servos is None):
        raise UsageError(
            "--format lerobot writes a copy of a calibration: name it with --calibration, its make with --servos."
        )
    found = [_search(model, logs, asked, as_json) for model in asked.models]
    documents = [document for document, _ in found]
    if asked.output is not None:
        rendered = _render(asked, *found[0])
        write(asked.output, rendered.text.encode())
        documents[0] |= {"output": str(asked.output), "notes": [*documents[0]["notes"], *rendered.notes]}
    if asked.ranges is not None:
        write(asked.ranges, servo_gap.write_json_for_yaml(documents[0]["ranges"]).encode())
        documents[0]["ranges_file"] = str(asked.ranges)
    document = documents[0] if len(documents) == 1 else {"models": documents, "headline": _compare(documents)}
    emit(document, as_json, partial(_show, details=details))


def _render(asked: ModelSearch, document: Mapping[str, Any], copy: Patched) -> Rendered:
    """Write what was found for the simulator, or for LeRobot, that was asked for.

    Raises:
        UsageError: no zero was found that LeRobot's calibration could have.

    """
    if asked.form != "lerobot":
        return servo_gap.render_copy(asked.form, asked.models[0].stem, copy)
    assert asked.calibration is not None
    assert asked.servos is not None
    zeros = {
        one["joint"]: -one["parameters"][0]["value"]
        for one in document["effects"]
        if one["id"] == "zero_offset" and one["sure"] == "certain" and not one["alias_set"]
    }
    if not zeros:
        raise UsageError(
            "No joint has another zero by these logs, and LeRobot's calibration has nothing else that a search finds: "
            "friction, gains and delays are of a simulator, --format mjcf, sdf or isaaclab."
        )
    calibration = files_formats.of_follower(asked.calibration)
    text, _ = files_formats.with_zero_offsets(calibration, zeros, asked.norm_mode or "RANGE_M100_100", asked.servos)
    listed = ", ".join(f"{joint} by {degrees:.2f} deg" for joint, degrees in zeros.items())
    notes = f"LeRobot: homing offsets of {listed}. Friction, gains and delays have no place in its files."
    return simulators.Rendered(text, (notes,))


def _search(model: Path, logs: Sequence[str], asked: ModelSearch, as_json: bool) -> tuple[dict[str, Any], Patched]:
    hints = LogHints(calibration=asked.calibration, norm_mode=asked.norm_mode)
    options = servo_gap.LogOptions(
        split_names(asked.joints), asked.site, asked.payload_body, hints, asked.column_map, asked.ranges_percent
    )
    with job_bar(f"gap of {model.name}", as_json) as progress:
        return servo_gap.find_servo_gap(model, list(logs), list(asked.held), options, asked.seed or 0, progress)


def _compare(documents: Sequence[Mapping[str, Any]]) -> str:
    best = min(documents, key=lambda one: _error(one, "stated"))
    refuted = [one["model"] for one in documents if one["refuted"]]
    said = f"Nearest to the log as it stands: {best['model']} ({_error(best, 'stated'):.2g} deg on unseen motion)."
    if refuted:
        said += f" Refuted by the log: {', '.join(refuted)}."
    return said


def _error(document: Mapping[str, Any], which: str) -> float:
    one = document["whole_arm"][which]
    return float("inf") if one is None else float(one["rms_deg"])


def _show(document: Mapping[str, Any], details: bool) -> None:
    print_line(document["headline"])
    if "models" in document:
        rows = [(one["model"], *(_cell(one, which) for which in ERRORS)) for one in document["models"]]
        show_rows(("model", "as it is, deg", "servo fitted", "with what was found"), rows, numbers=True)
        for one in document["models"]:
            for line in _list_differences(one)[: None if details else 3]:
                print_line(f"{one['model']}: {line}")
        return
    for warning in document["warnings"]:
        print_line(f"Warning: {warning['message']}")
    if document["effects"]:
        rows = [_row(one) for one in document["effects"]]
        show_rows(("effect", "size", "interval (95 %)", "sure"), rows)
    whole = document["whole_arm"]
    where = "unseen episodes" if whole["unseen"] else "the log"
    rows = [(name, _cell(document, key), _mm(whole[key])) for key, name in ERRORS.items()]
    show_rows((f"whole arm on {where}", "deg rms", f"mm at {whole['site'] or 'no site'}"), rows, numbers=True)
    if details:
        _show_details(document)
    for text in document["notes"]:
        print_line(text)
    for key in ("output", "ranges_file"):
        if key in document:
            print_line(f"Written: {document[key]}")
    if "output" not in document and (document["effects"] or document["refuted"]):
        print_line("Next: the same with --output FILE.xml writes a copy of the model with all of this.")


def _row(one: Mapping[str, Any]) -> tuple[str, ...]:
    value = one["parameters"][0]
    interval = f"{value['interval_low']:.4g} to {value['interval_high']:.4g}"
    rivals = f" (or {', '.join(one['alias_set'])})" if one["alias_set"] else ""
    return one["label"], f"{value['value']:.3g} {value['unit']}", interval, f"{one['sure']}{rivals}"


def _cell(document: Mapping[str, Any], which: str) -> str:
    error = _error(document, which)
    return "diverges" if error == float("inf") else f"{error:.3g}"


def _mm(one: Mapping[str, Any] | None) -> str:
    return "" if one is None or one["tool_rms_mm"] is None else f"{one['tool_rms_mm']:.3g}"


def _list_differences(document: Mapping[str, Any]) -> list[str]:
    """Numbers of the servos that the log refutes, those that are furthest off first."""
    found = []
    for joint in document["joints"]:
        for one in joint["servo"]:
            if not one["interval_low"] <= one["stated"] <= one["interval_high"] and one["found"] > 0.0:
                ratio = max(one["stated"], 1e-12) / one["found"]
                said = f"{one['stated']:.3g}, the log says {one['found']:.3g} {one['unit']}"
                text = f"{one['name']} of {joint['joint']} is {said}"
                found.append((abs(ratio - 1.0) if ratio >= 1.0 else 1.0 / ratio - 1.0, text))
    return [text for _, text in sorted(found, reverse=True)]


def _show_details(document: Mapping[str, Any]) -> None:
    rows = [
        (
            joint["joint"],
            one["name"],
            f"{one['stated']:.4g}",
            f"{one['without_effects']:.4g}",
            f"{one['found']:.4g}",
            f"{one['interval_low']:.4g} to {one['interval_high']:.4g}",
            one["unit"],
        )
        for joint in document["joints"]
        for one in joint["servo"]
    ]
    show_rows(("joint", "number", "model", "fitted alone", "with effects", "interval (95 %)", "unit"), rows)
    limits = [(one["joint"], one["id"], f"{one['at_most']:.3g} {one['unit']}") for one in document["excluded"]]
    show_rows(("joint", "not found", "at most (95 %)"), limits)
