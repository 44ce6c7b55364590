"""``kilter try | demo``: from a file of measurements to one page, or a simulated arm, on a server that runs meanwhile."""

from __future__ import annotations

import io
import os
import shlex
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.cli.files.upload import Device, Joints, PresetName
from kilter_client.cli.terminal.arguments import ColumnMap, Json
from kilter_client.cli.terminal.output import emit, note, print_line
from kilter_client.errors import UsageError
from kilter_client.requests.calls.jobs import report_page
from kilter_client.requests.connection import local_server
from kilter_client.results.rows import write_file

ROBOT = "arm"
CIRCLE_S = 8.0  # that the demo drives
HELD_OUT = "0.25"  # of the poses: what a search says is checked on poses that it has not seen
Measured = Annotated[
    list[Path], typer.Argument(metavar="FILE...", help="Measurements of the arm.", exists=True, show_default=False)
]


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command("try", epilog="Example: kilter try measured.csv --robot katana450-chapter5")(try_files)
    app.command(epilog="Example: kilter server demo")(demo)


def try_files(
    files: Measured,
    robot: Annotated[
        str, typer.Option(help="A preset, or a file of the robot: URDF, DH table, robot.json.", show_default=False)
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The page to write.")] = Path("kilter-trial.html"),
    device: Device = None,
    preset: PresetName = None,
    column_map: ColumnMap = None,
    joints: Joints = None,
    payload_kg: Annotated[float | None, typer.Option(help="Mass at the tool point, kg.")] = None,
    as_json: Json = False,
) -> None:
    """Find what a robot's model lacks, without a server: read, identify, search, and write one page.

    What it stores is in a temporary folder that goes when it ends. Each step is the command that does the same on a server.
    """
    _need_server("try")
    stated = {"device": device, "preset": preset, "map": column_map, "joints": joints, "payload-kg": payload_kg}
    options = [f"--{name}={value}" for name, value in stated.items() if value is not None]
    with _server_for_trial(as_json):
        given = [robot, "--name", ROBOT] if Path(robot).exists() else ["--preset", robot, "--name", ROBOT]
        _step(["robot", "add", *given], as_json, quiet=True)
        for file in files:
            _step(["upload", ROBOT, str(file), *options], as_json)
        with Kilter() as kilter:
            named = ((one["id"], one["name"]) for one in kilter.campaigns.list(ROBOT))
            campaigns = ",".join(key if "," in name else name for key, name in named)
            for kind in ("identify", "gap"):
                _step(
                    [kind, ROBOT, "--campaign", campaigns, "--validation", HELD_OUT], as_json, quiet=kind == "identify"
                )
            found = {job["kind"]: kilter.jobs.get(job["id"]) for job in kilter.jobs.list(ROBOT)}
            write_file(kilter.run(report_page(found["gap"]["id"])), output)
    emit({"report": str(output), **found}, as_json, _show)


def demo(
    circle_s: Annotated[float, typer.Option(min=0.1, help="Seconds that the circle takes.")] = CIRCLE_S,
    as_json: Json = False,
) -> None:
    """Calibrate and correct a simulated Katana 450, from measured poses to corrected setpoints, without a server.

    With --json: the error along the circle that it drives, before and after.
    """
    _need_server("demo")
    from kilter_client.cli.demo import run_demo  # it has the core, which a client alone does without

    with redirect_stdout(io.StringIO()) if as_json else nullcontext():
        record = run_demo(circle_s)
    emit(record, as_json, lambda _: None)


def _need_server(command: str) -> None:
    if getattr(find_spec("kilter_service"), "origin", None) is None:  # a folder that was left behind has none
        raise UsageError(
            f"kilter {command} runs a server for a while, and it is not installed here: install the wheels of kilter and "
            "kilter_core, or in the repository `pip install ./core ./clients/files .`."
        )


@contextmanager
def _server_for_trial(as_json: bool) -> Iterator[None]:
    """Run a server with a folder of its own; the commands of this process go to it meanwhile."""
    note("Starting Kilter in a temporary folder. The first time it compiles for a minute.", as_json)
    before = dict(os.environ)
    with tempfile.TemporaryDirectory(prefix="kilter-try-") as folder, local_server(Path(folder) / "data") as server:
        os.environ.pop("KILTER_TOKEN", None)
        os.environ.update(server.environment())
        try:
            yield
        finally:
            os.environ.clear()
            os.environ.update(before)


def _step(arguments: Sequence[str], as_json: bool, quiet: bool = False) -> None:
    """Run a command as a person would, and say which; ``quiet`` leaves out what it prints."""
    note(f"$ kilter {shlex.join(arguments)}", as_json)
    said = io.StringIO()
    with redirect_stdout(said) if as_json or quiet else nullcontext():
        code = run([*arguments, *(["--json"] if as_json else [])])
    if code:
        if as_json:
            print_line(said.getvalue().rstrip())
        raise typer.Exit(code)


def _show(document: dict[str, Any]) -> None:
    print_line(f"\n{document['report']} has all of it on one page. Nothing else was kept.")
    print_line("To keep robots, campaigns and versions: kilterd serve, then the commands above.")
