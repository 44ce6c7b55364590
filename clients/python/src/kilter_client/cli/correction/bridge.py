"""``kilter bridge``: the correction between a controller and its arm, in a process of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kilter_client.bridges.egm import AXES, EgmWire, From, RsiWire
from kilter_client.bridges.egm import AXES as EGM_AXES
from kilter_client.bridges.fci import CYCLE_S as FCI_CYCLE_S
from kilter_client.bridges.plan import Setpoints, open_plan
from kilter_client.cli.groups import Group
from kilter_client.cli.terminal.arguments import Json, Robot
from kilter_client.cli.terminal.output import emit, print_line
from kilter_client.errors import MissingPackageError

if TYPE_CHECKING:
    from kilter_client.bridges.running import Bounds

Version = Annotated[
    str | None,
    typer.Option(help="Version to correct with: id, name, or `latest`; default: the active one, whichever that is."),
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Even if the controller corrects by itself, or nobody said whether it does."),
]
Listen = Annotated[str, typer.Option("--listen", metavar="ADDRESS", help="Address of this machine to listen on.")]
Controller = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Address of the controller, with :PORT if it has always the same; others get no answer. Default: whoever asks "
        "first.",
    ),
]
Signs = Annotated[
    str | None,
    typer.Option(help="Signs of the controller's axes against the robot's joints, as +,-,+,+,-,+; default: all +."),
]
Largest = Annotated[float, typer.Option(min=0.001, max=10.0, help="Largest offset of a joint, deg.")]
Rate = Annotated[float, typer.Option(min=0.001, max=100.0, help="Fastest change of an offset, deg/s.")]
Ramp = Annotated[float, typer.Option(min=0.0, max=60.0, help="Over which offsets come in and go out, s.")]
GoneAfter = Annotated[
    float,
    typer.Option(
        min=0.05, max=60.0, help="Silence after which the controller has stopped, s. Longer than its own time-out."
    ),
]
Publish = Annotated[str, typer.Option(metavar="ENDPOINT", help="Zenoh endpoint to publish the state on; port 0: any.")]
PathFile = Annotated[
    Path | None,
    typer.Option(
        "--path",
        help="Table of setpoints (t_s, q1_deg, ...): played when the controller begins.",
        exists=True,
        dir_okay=False,
    ),
]
SetpointsPort = Annotated[
    int | None,
    typer.Option(min=1, max=65535, help="UDP port of this machine to which a planner sends setpoints."),
]
Speed = Annotated[float, typer.Option(min=0.1, max=500.0, help="Setpoints that move faster are not followed, deg/s.")]

bridge = typer.Typer(
    help="Correct an arm from a process between its controller and its drives.",
    no_args_is_help=True,
    rich_markup_mode=None,
    cls=Group,
)


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.add_typer(bridge, name="bridge")


@bridge.command(epilog="Example: kilter bridge rsi cell7 --listen 192.168.1.10 --controller 192.168.1.20")
def rsi(
    robot: Robot,
    listen: Listen = "127.0.0.1",
    controller: Controller = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="UDP port that the controller sends to; 0: any.")] = 59152,
    cycle_ms: Annotated[float, typer.Option(min=1.0, max=100.0, help="Cycle of the controller, ms: 4 or 12.")] = 4.0,
    joints_from: Annotated[
        From, typer.Option(help="The wanted joints: the setpoints, or the actual joints less what was offset.")
    ] = From.SETPOINT,
    signs: Signs = None,
    version: Version = None,
    largest_deg: Largest = 1.0,
    rate_deg_s: Rate = 5.0,
    ramp_s: Ramp = 2.0,
    gone_after_s: GoneAfter = 2.0,
    publish: Publish = "tcp/127.0.0.1:0",
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Answer a KUKA controller (RobotSensorInterface) with joint offsets AK: XML over UDP.

    Ctrl-C fades the offsets out and ends; a second one ends at once.
    """
    running = _import_bridge_runtime()
    start = running.prepare_bridge(robot, "rsi", version, force, as_json, publish)
    wire = RsiWire(running.parse_axis_signs(signs, start.joints, AXES), joints_from, cycle_ms)
    bounds: Bounds = running.Bounds(largest_deg, rate_deg_s, ramp_s, cycle_ms, gone_after_s)
    emit(running.answer_over_udp(start, wire, bounds, listen, port, controller), as_json, _show)


@bridge.command(
    epilog="Example: kilter bridge egm cell7 --listen 192.168.1.10 --controller 192.168.1.20 --setpoints-port 6600"
)
def egm(
    robot: Robot,
    path: PathFile = None,
    setpoints_port: SetpointsPort = None,
    listen: Listen = "127.0.0.1",
    controller: Controller = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="UDP port that the controller sends to; 0: any.")] = 6510,
    cycle_ms: Annotated[float, typer.Option(min=1.0, max=100.0, help="Cycle of the controller, ms.")] = 4.0,
    speed_deg_s: Speed = 30.0,
    signs: Signs = None,
    version: Version = None,
    largest_deg: Largest = 1.0,
    rate_deg_s: Rate = 5.0,
    ramp_s: Ramp = 2.0,
    gone_after_s: GoneAfter = 2.0,
    publish: Publish = "tcp/127.0.0.1:0",
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Guide an ABB controller (Externally Guided Motion, joints) along corrected setpoints: protobuf over UDP.

    The setpoints come from a file, or from a planner. Ctrl-C fades the offsets out and ends; a second one ends at once.
    """
    running = _import_bridge_runtime()
    start = running.prepare_bridge(robot, "egm", version, force, as_json, publish)
    bounds: Bounds = running.Bounds(largest_deg, rate_deg_s, ramp_s, cycle_ms, gone_after_s)
    plan = open_plan(path, setpoints_port, start.found.limits_deg)
    setpoints = Setpoints(plan, math.radians(speed_deg_s), bounds.cycle_s)
    wire = EgmWire(running.parse_axis_signs(signs, start.joints, EGM_AXES), setpoints)
    emit(running.answer_over_udp(start, wire, bounds, listen, port, controller), as_json, _show)


@bridge.command(epilog="Example: kilter bridge fci fr3 172.16.0.2 --path weld.csv")
def fci(
    robot: Robot,
    address: Annotated[str, typer.Argument(help="Address of the robot.", show_default=False)],
    path: Annotated[
        Path,
        typer.Option(
            "--path", help="Table of setpoints (t_s, q1_deg, ...), a row each ms.", exists=True, dir_okay=False
        ),
    ],
    speed_deg_s: Speed = 60.0,
    version: Version = None,
    largest_deg: Largest = 1.0,
    rate_deg_s: Rate = 5.0,
    ramp_s: Ramp = 2.0,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Refuse to run without real-time kernel and priority.")
    ] = False,
    publish: Publish = "tcp/127.0.0.1:0",
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Move a Franka robot along corrected setpoints (Franka Control Interface, joint positions).

    Ctrl-C brings the arm to rest, fades the offsets out and ends; a second one ends at once.
    """
    running = _import_bridge_runtime()
    start = running.prepare_bridge(robot, "fci", version, force, as_json, publish)
    bounds: Bounds = running.Bounds(largest_deg, rate_deg_s, ramp_s, 1000.0 * FCI_CYCLE_S, 0.0)
    setpoints = Setpoints(open_plan(path, None, start.found.limits_deg), math.radians(speed_deg_s), FCI_CYCLE_S)
    emit(running.move_by_fci(start, setpoints, bounds, address, realtime), as_json, _show)


def _import_bridge_runtime() -> Any:
    """Import what a bridge needs."""
    try:
        from kilter_client.bridges import running
    except ImportError as error:
        raise MissingPackageError(
            f"A bridge corrects by itself and needs {error.name}: install the client with its extra `bridge`."
        ) from error
    return running


def _show(document: Mapping[str, Any]) -> None:
    counts = document["counts"]
    took = document.get("answer_us") or {}
    print_line(
        f"{document['bridge']} bridge of {document['robot']}: {counts.get('answered', 0)} answers, late {counts.get('late', 0)}"
    )
    for name, count in counts.items():
        if count and name not in ("answered", "late"):
            print_line(f"  {name}: {count}")
    for name, count in document["refused"].items():
        print_line(f"  not corrected, {name}: {count}")
    if document["controller_missed"] is not None:
        print_line(f"  missed by the controller's own count: {document['controller_missed']}")
    if document.get("command_success_rate") is not None:
        print_line(f"  commands that came in time, of the last 100: {100 * document['command_success_rate']:.0f} %")
    if took.get("p50") is not None:
        print_line(
            f"  answer after {took['p50']} us (median), {took['p99']} us (p99), at most {document['answer_longest_us']} us"
        )
