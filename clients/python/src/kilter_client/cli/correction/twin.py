"""``kilter version twin compare | onto | read``: how far a model of MuJoCo is from measured poses; a calibrated copy."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import Json, VersionId, split_names
from kilter_client.cli.terminal.output import emit, job_bar, print_line, show_rows
from kilter_client.cli.terminal.references import (
    OfRobot,
    job_goes_on,
    on_interrupt,
    resolve_reference,
    resolved_options,
)
from kilter_client.errors import UsageError
from kilter_client.results.shown_jobs import MODELS as STAGES
from kilter_client.twin.drives import read_drives
from kilter_client.twin.onto import lay_onto
from kilter_client.twin.settled import Settings, ViewErrors, load_model, model_errors, read_measured_rows
from kilter_client.twin.usd import USD_SUFFIXES, lay_over
from kilter_files.ground.later import np

if TYPE_CHECKING:
    from numpy.typing import NDArray

group = typer.Typer(
    help="Score a simulator's model on measured poses, and calibrate it.", rich_markup_mode=None, no_args_is_help=True
)
MODELS = {"nominal": "registration_only", "without_effects": "without_effects", "identified": "identified"}
WORDS = {"without_effects": STAGES["without_effects"]}
EARLIER = "rigid"  # what `without_effects` was called; scripts may read it
Model = Annotated[
    Path, typer.Argument(help="An MJCF file.", metavar="MODEL", show_default=False, exists=True, dir_okay=False)
]
ModelJoints = Annotated[
    list[str] | None,
    typer.Option(
        "--joints", metavar="A,B,C", help="The model's joints in the robot's order; left out: named as the robot's."
    ),
]
MEASURES = ("mean_mm", "rms_mm", "p95_mm", "max_mm")


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.add_typer(group, name="twin")


@group.command(epilog="Example: kilter version twin compare so101.xml held-out --robot my-arm")
def compare(
    model: Model,
    campaign: Annotated[
        str, typer.Argument(help="Measured poses: id, name or `latest`.", metavar="CAMPAIGN", show_default=False)
    ],
    version: Annotated[
        str | None, typer.Option(help="The version beside it; left out: the active one, else the nominal robot.")
    ] = None,
    joints: ModelJoints = None,
    site: Annotated[str, typer.Option(help="The model's site at the tool.")] = "tool",
    payload_body: Annotated[str, typer.Option(help="The model's body whose mass is the payload.")] = "payload",
    step_ms: Annotated[float | None, typer.Option(help="Time step; left out: the model's.", min=0.01, max=20.0)] = None,
    rows: Annotated[int, typer.Option(help="Rows to settle at most, evenly chosen.", min=6, max=5000)] = 200,
    robot: OfRobot = None,
    as_json: Json = False,
) -> None:
    """Score a model on measured poses, settled, beside the nominal arm and a version; base and tool fitted for each."""
    found = load_model(model)
    with Kilter() as kilter:
        used = resolve_reference(kilter, "campaign", campaign, robot, as_json)
        known = kilter.campaigns.get(used)
        of = kilter.robots.get(known["robot"])
        measured = read_measured_rows(
            kilter.campaigns.rows(used), len(of["joints"]), known.get("conditions") or {}, rows
        )
        job = _run_evaluation(kilter, known["robot"], used, version, as_json)
    names = split_names(joints) or [joint["name"] for joint in of["joints"]]
    if len(names) != len(of["joints"]):
        raise UsageError(f"--joints names {len(names)} joints, robot {known['robot']} has {len(of['joints'])}.")
    settings = Settings(names, site, payload_body, None if step_ms is None else step_ms * 1e-3)
    apart = model_errors(found, measured, settings, model)
    emit(_document(model, used, job, apart), as_json, _show)


@group.command(epilog="Example: kilter version twin onto so101.xml so101 v2 -o so101-0042.xml")
def onto(
    model: Model,
    version: VersionId,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: a copy for this one arm.")],
    joints: ModelJoints = None,
    site: Annotated[str | None, typer.Option(help="The model's site at the tool, which moves with it.")] = None,
    robot: OfRobot = None,
    as_json: Json = False,
) -> None:
    """Write a copy of a model, or a layer over a stage of USD, with a version's poses and drives; the model stays as it is."""
    if output.resolve() == model.resolve():
        raise UsageError(f"{output} is the model itself, which stays as it is: name another file.")
    usd = model.suffix.lower() in USD_SUFFIXES
    if usd and site is not None:
        raise UsageError(
            "--site is of models of MuJoCo: leave it out, in a stage of USD the tool is the frame kilter_tool."
        )
    if usd and output.suffix.lower() not in (".usda", ".usd"):
        raise UsageError(f"{output} is to be a layer of USD, as text: name it .usda.")
    with Kilter() as kilter:
        version = resolve_reference(kilter, "version", version, robot, as_json)
        twin = kilter.versions.export(version, "usd" if usd else "mjcf").decode()
    names = split_names(joints)
    laid = lay_over(model, twin, output, names) if usd else lay_onto(model, twin, names, site)
    write(output, laid.text.encode())
    emit({"version_id": version, "output": str(output), "notes": list(laid.notes)}, as_json, _show_laid)


@group.command(
    epilog="Example: kilter version twin read so101.xml --joints 1,2,3,4,5 --robot-file so101.json -o soft.json"
)
def read(
    model: Model,
    joints: Annotated[
        list[str], typer.Option("--joints", metavar="A,B,C", help="The model's joints in the robot's order.")
    ],
    robot_file: Annotated[
        Path | None,
        typer.Option(help="A robot document (JSON) to write with these drives.", exists=True, dir_okay=False),
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="The copy of --robot-file to write.")] = None,
    as_json: Json = False,
) -> None:
    """Read stiffness, friction and backlash that a model states as starting values of effects, and say what is left."""
    if (robot_file is None) != (output is None):
        raise UsageError(
            "--robot-file and --output go together: a robot document, and the copy with the model's drives."
        )
    found = read_drives(load_model(model), split_names(joints), model)
    if robot_file is not None and output is not None:
        write(output, _with_drives(robot_file, found.stiffness).encode())
    document = {
        "model": str(model),
        "stated": [vars(one) for one in found.stated],
        "effects": found.effects,
        "left": list(found.left),
    }
    emit(document, as_json, _show_read)


def _with_drives(robot_file: Path, stiffness: Sequence[float | None]) -> str:
    try:
        robot = json.loads(robot_file.read_text(encoding="utf-8"))
        joints = robot.get("joints") or [{"name": f"j{k + 1}"} for k in range(len(stiffness))]
    except (ValueError, AttributeError) as error:
        raise UsageError(f"--robot-file {robot_file}: is not a robot document ({error}).") from error
    if len(joints) != len(stiffness):
        raise UsageError(f"--joints names {len(stiffness)} joints, {robot_file} has {len(joints)}.")
    told = [
        joint if k is None else joint | {"drive_stiffness_nm_rad": k}
        for joint, k in zip(joints, stiffness, strict=True)
    ]
    return json.dumps(robot | {"joints": told}, indent=2) + "\n"


def _show_read(document: Mapping[str, Any]) -> None:
    rows = [
        (
            one["joint"],
            f"{one['source']} {one['value']:.4g} {one['unit']}",
            one["effect"],
            f"{one['start']:.4g}",
            one["start_unit"],
        )
        for one in document["stated"]
    ]
    show_rows(("joint", "in the model", "effect", "start", "unit"), rows)
    for line in document["left"]:
        print_line(f"left out: {line}")
    if document["effects"]:
        print_line("identify with: " + " ".join(f"--effects '{json.dumps(effect)}'" for effect in document["effects"]))


def _show_laid(document: Mapping[str, Any]) -> None:
    for note in document["notes"]:
        print_line(f"  {note}")
    print_line(f"{document['output']}: the tool is at kilter_tool")


def _run_evaluation(kilter: Kilter, robot: str, campaign: str, version: str | None, as_json: bool) -> dict[str, Any]:
    options = resolved_options(kilter, {} if version is None else {"version": version}, robot, as_json)
    job = kilter.jobs.submit("evaluate", robot, [campaign], None, options | {"refit": ["base", "tool"]}, [], "")
    with on_interrupt(partial(job_goes_on, job)), job_bar("evaluate", as_json) as progress:
        done: dict[str, Any] = kilter.jobs.wait(job["id"], progress)
    return done


def _document(
    model: Path, campaign: str, job: Mapping[str, Any], apart: ViewErrors | NDArray[np.float64]
) -> dict[str, Any]:
    result = job["result"]
    errors = result["metrics"][campaign]
    mm = 1e3 * (apart.tool if isinstance(apart, ViewErrors) else apart)
    own = {
        "mean_mm": float(mm.mean()),
        "rms_mm": float(np.sqrt(np.mean(mm**2))),
        "p95_mm": float(np.percentile(mm, 95)),
        "max_mm": float(mm.max()),
    }
    others = {
        name: {key: errors[stage].get(key) for key in MEASURES} for name, stage in MODELS.items() if errors.get(stage)
    }
    if "without_effects" in others:
        others[EARLIER] = others["without_effects"]
    return {
        "campaign_id": campaign,
        "version_id": result["version_id"],
        "model": str(model),
        "rows": len(mm),
        "errors": others | {str(model): own},
        "warnings": result.get("warnings") or [],
        "pixels": {"rms_px": apart.rms_px, "noise_px": apart.noise_px} if isinstance(apart, ViewErrors) else None,
    }


def _show(document: Mapping[str, Any]) -> None:
    show_rows(("arm", "mean mm", "rms mm", "95 % mm", "max mm"), list(_lines(document["errors"])), numbers=True)
    print_line(
        f"{document['model']} settled at {document['rows']} rows of {document['campaign_id']}; base and tool fitted for each."
    )
    if document["pixels"] is not None:
        px = document["pixels"]
        print_line(
            f"Views: millimetres are the tool's, without the noise of corners. {document['model']} leaves "
            f"{px['rms_px']:.2f} px (rms of a coordinate of a corner), of which {px['noise_px']:.2f} px are noise within views."
        )
    for warning in document["warnings"]:
        print_line(f"warning: {warning['message']}")


def _lines(errors: Mapping[str, Mapping[str, float | None]]) -> Iterator[tuple[str, ...]]:
    for name, own in errors.items():
        if name != EARLIER:
            yield (WORDS.get(name, name), *("" if own[key] is None else f"{own[key]:.4f}" for key in MEASURES))
