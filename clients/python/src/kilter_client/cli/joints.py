"""``kilter measure joint-parameters``: what joints do on their own, by inclinometer or by encoders on the link side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client.cli.analyse import needs_result, run_job, write_poses
from kilter_client.cli.terminal import arguments
from kilter_client.cli.terminal.arguments import (
    CampaignIds,
    JobName,
    Json,
    MoreOptions,
    NoWait,
    PayloadCentre,
    Robot,
    ValidationText,
    with_flags,
)
from kilter_client.errors import UsageError
from kilter_client.typed.option_texts import JOINT_PARAMETERS
from kilter_files.rig import read_readings


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter measure joint-parameters katana --readings joint3.csv")(joint_parameters)


@with_flags("joint_parameters", seldom=("payloads_kg",))
def joint_parameters(
    robot: Robot,
    readings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Inclinometer readings, CSV.", exists=True, dir_okay=False)
    ] = None,
    campaign: CampaignIds = None,
    validation: ValidationText = None,
    propose: Annotated[str | None, typer.Option(metavar="JOINT", help=JOINT_PARAMETERS["propose"])] = None,
    count: Annotated[int | None, typer.Option(min=4, help=JOINT_PARAMETERS["count"])] = None,
    payload_kg: Annotated[list[float] | None, typer.Option(help=JOINT_PARAMETERS["payloads_kg"], min=0.0)] = None,
    payload_com_mm: PayloadCentre = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Write the proposal as CSV, to be filled in.", dir_okay=False
        ),
    ] = None,
    option: MoreOptions = None,
    name: JobName = "",
    no_wait: NoWait = False,
    as_json: Json = False,
) -> None:
    """Measure clearance, backlash and stiffness of joints directly, or say where to read for that."""
    _refuse_two_ways({"--readings": readings, "--campaign": campaign, "--propose": propose})
    needs_result(no_wait, output=output)
    if output is not None and propose is None:
        raise UsageError("--output writes a proposal: give --propose JOINT.")
    chosen = arguments.options(
        option,
        propose=propose,
        count=count,
        payloads_kg=payload_kg or None,
        payload_com_mm=arguments.three("--payload-com-mm", payload_com_mm),
    )
    if readings is not None:
        chosen["readings"] = read_readings(readings)

    def files(job: dict[str, Any]) -> None:
        if output is not None:
            write_poses(output, (job.get("result") or {}).get("csv"), as_json)

    run_job(
        "joint_parameters",
        robot,
        campaign,
        validation,
        chosen,
        no_wait,
        as_json,
        needs_campaign=False,
        files=files,
        name=name,
    )


def _refuse_two_ways(ways: dict[str, object]) -> None:
    given = [name for name, there in ways.items() if there]
    if len(given) != 1:
        raise UsageError(
            "Give one of --readings FILE (inclinometer), --campaign ID (encoders, inclinometers) and --propose JOINT, "
            f"not {' and '.join(given) or 'none'}."
        )
