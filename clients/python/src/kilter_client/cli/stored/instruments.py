"""``kilter measure instrument``: what was measured with."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import Group
from kilter_client.cli.terminal.arguments import Json
from kilter_client.cli.terminal.output import emit, print_line, show_rows
from kilter_client.requests.calls import campaigns
from kilter_client.verbs.inputs import parse_day

instrument = typer.Typer(
    help="Instruments and their certificates.", no_args_is_help=True, rich_markup_mode=None, cls=Group
)


class Kind(StrEnum):
    """What an instrument is."""

    laser_tracker = "laser_tracker"
    arm_cmm = "arm_cmm"
    cmm = "cmm"
    camera = "camera"
    ball_bar = "ball_bar"
    other = "other"


class Standard(StrEnum):
    """What states a permissible error."""

    iso_10360_10 = "iso_10360_10"
    iso_10360_12 = "iso_10360_12"
    other = "other"


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.add_typer(instrument, name="instrument")


@instrument.command(
    epilog="Example: kilter measure instrument add tracker-2026 --kind laser_tracker --serial-number 502113 --mpe-um 15 "
    "--mpe-um-per-m 6 --mpe-standard iso_10360_10 --certificate K-1234 --valid-until 2027-01-10"
)
def add(
    name: Annotated[str, typer.Argument(help="Name to give it with this certificate.", show_default=False)],
    kind: Annotated[Kind, typer.Option(help="What it is.", show_default=False)],
    serial_number: Annotated[str, typer.Option(help="Serial number, as on its plate.", show_default=False)],
    mpe_um: Annotated[float, typer.Option(min=0.0, help="Permissible error at length 0, um.", show_default=False)],
    mpe_um_per_m: Annotated[float, typer.Option(min=0.0, help="What it grows by per length, um/m.")] = 0.0,
    mpe_standard: Annotated[Standard, typer.Option(help="What states the permissible error.")] = Standard.other,
    certificate: Annotated[str, typer.Option(help="Number of the calibration certificate.")] = "",
    certified_on: Annotated[str | None, typer.Option(metavar="DAY", help="Day of the certificate: 2026-01-10.")] = None,
    valid_until: Annotated[str | None, typer.Option(metavar="DAY", help="Last day on which it holds.")] = None,
    notes: Annotated[str, typer.Option(help="Notes kept with the instrument.")] = "",
    as_json: Json = False,
) -> None:
    """Add an instrument with its permissible error and certificate.

    The error of a length is um + um/m x length. With the next certificate it is added under another name: what was
    measured before keeps the certificate of then.
    """
    wanted: dict[str, Any] = {
        "name": name,
        "kind": kind.value,
        "serial_number": serial_number,
        "mpe_standard": mpe_standard.value,
        "mpe_um": mpe_um,
        "mpe_um_per_m": mpe_um_per_m,
        "certificate": certificate,
        "certified_on": parse_day(certified_on),
        "valid_until": parse_day(valid_until),
        "notes": notes,
    }
    with Kilter() as kilter:
        emit(kilter.run(campaigns.add_instrument(wanted)), as_json, _show_one)


@instrument.command("list", epilog="Example: kilter measure instrument list")
def list_(as_json: Json = False) -> None:
    """List the instruments with their errors and certificates."""
    with Kilter() as kilter:
        emit({"instruments": kilter.run(campaigns.list_instruments())}, as_json, _show)


def _show_one(one: dict[str, Any]) -> None:
    print_line(f"instrument {one['name']}: {one['kind']}, serial number {one['serial_number']}, MPE {_mpe(one)}")


def _show(document: dict[str, Any]) -> None:
    rows = [
        (
            one["name"],
            one["kind"],
            one["serial_number"],
            _mpe(one),
            one["mpe_standard"],
            one["certificate"] or "none",
            one["valid_until"] or "not stated",
        )
        for one in document["instruments"]
    ]
    if rows:
        show_rows(("instrument", "kind", "serial number", "MPE", "by", "certificate", "valid until"), rows)
    else:
        print_line("There is no instrument yet: add it with `kilter measure instrument add`.")


def _mpe(one: dict[str, Any]) -> str:
    return f"{one['mpe_um']:g} um + {one['mpe_um_per_m']:g} um/m x L"
