"""The columns of observations, their quantities and units; and the options that the core declares, from `options.json`.

Options that the core declares, made from `options.json`: `make contract` writes it from the core's dataclasses.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast

from pydantic import Field, create_model

from kilter_service.contract.units import Asked, JointNumber, unit

RAD = math.pi / 180.0
ANGLES = {"deg": RAD, "rad": 1.0}
LENGTHS = {"mm": 1e-3, "m": 1.0}

# quantity of a numbered column -> units of a revolute joint, units of a prismatic joint; the value is the factor to SI
JOINT_UNITS: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "q": (ANGLES, LENGTHS),
    "link": (ANGLES, LENGTHS),
    "cmd": (ANGLES, LENGTHS),
    "qd": ({f"{u}_s": f for u, f in ANGLES.items()}, {f"{u}_s": f for u, f in LENGTHS.items()}),
    "qdd": ({f"{u}_s2": f for u, f in ANGLES.items()}, {f"{u}_s2": f for u, f in LENGTHS.items()}),
    "tau": ({"nm": 1.0}, {"n": 1.0}),
    "dir": ({"": 1.0}, {"": 1.0}),
}
PAYLOAD_CENTRE = ("payload_com_x", "payload_com_y", "payload_com_z")
# quantity of a plain column -> its units
PLAIN_UNITS: dict[str, dict[str, float]] = {
    **dict.fromkeys(("x", "y", "z"), LENGTHS),
    **{f"s{axis}": LENGTHS for axis in "xyz"},
    **dict.fromkeys(("phi", "theta", "psi"), ANGLES),
    **{part: {"": 1.0} for part in ("qw", "qx", "qy", "qz")},
    "t": {"s": 1.0},
    "payload": {"kg": 1.0},
    **dict.fromkeys(PAYLOAD_CENTRE, LENGTHS),
    "temperature": {"c": 1.0},
    **dict.fromkeys(("base_tilt_x", "base_tilt_y"), ANGLES),
    "session": {"": 1.0},
    "pose_id": {"": 1.0},
    "row": {"": 1.0},
    **dict.fromkeys(("tipx", "tipy", "tipz"), LENGTHS),
    **{f"f{axis}": {"n": 1.0} for axis in "xyz"},
    **{f"m{axis}": {"nm": 1.0} for axis in "xyz"},
    **{f"{kind}_id": {"": 1.0} for kind in ("socket", "plane", "bar")},
    "bar": LENGTHS,
    **{what: {"": 1.0} for what in ("camera", "board")},
}
# Corners of a board that a camera saw, by number: `u1_px`, `v1_px`, and their standard deviations `su1_px`, `sv1_px`.
PIXEL_UNITS = {"px": 1.0}
PIXELS = ("pixel_u", "pixel_v", "pixel_su", "pixel_sv")
# Cells that may hold a name, of those that the campaign names in its conditions.
NAMED = {"camera": "cameras", "board": "boards"}
# Readings of inclinometers, by joint (0: the base) and axis of its frame: `tilt2x_deg`. A cell is empty where nothing was
# read.
TILT_UNITS = ANGLES
TILTS = ("tilt_x", "tilt_y", "tilt_z")
# Loads on links, by joint: `load3_kg` at `load3_x_mm` ... in the frame of the link, `load3_fx_n` ..., `load3_mx_nm` ...
LOAD_UNITS: dict[str, dict[str, float]] = {
    "load_kg": {"": 1.0},
    **{f"load_{axis}": LENGTHS for axis in "xyz"},
    **{f"load_f{axis}": {"n": 1.0} for axis in "xyz"},
    **{f"load_m{axis}": {"nm": 1.0} for axis in "xyz"},
}
LOAD_PARTS = (
    ("load_kg", "load_x", "load_y", "load_z"),
    ("load_fx", "load_fy", "load_fz"),
    ("load_mx", "load_my", "load_mz"),
)
BASE = -1  # number of a column of the base: behind those of the joints
PLACE = ("x", "y", "z", "qw", "qx", "qy", "qz", "phi", "theta", "psi")  # of the tool
CONTACTS = ("socket_id", "plane_id", "bar_id")
TOGETHER = (
    ("x", "y", "z"),
    ("sx", "sy", "sz"),
    ("qw", "qx", "qy", "qz"),
    ("phi", "theta", "psi"),
    ("tipx", "tipy", "tipz"),
    ("fx", "fy", "fz"),
    ("mx", "my", "mz"),
    PAYLOAD_CENTRE,
    ("base_tilt_x", "base_tilt_y"),
    ("bar_id", "bar"),
)


NUMBERS = {"float": float, "int": int, "bool": bool, "joint": JointNumber}
Declared = Mapping[str, Any]
OPTIONS: Mapping[str, Sequence[Declared]] = json.loads(
    Path(__file__).with_name("options.json").read_text(encoding="utf-8")
)
ModelT = TypeVar("ModelT", bound=type[Asked])


class WithCoreOptions(Asked):
    """Options of a job some of which the core declares."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


def with_core_options(kind: str) -> Callable[[ModelT], ModelT]:
    """Add to the options of a kind of job those that the core declares."""

    def add(model: ModelT) -> ModelT:
        made: Any = create_model(
            model.__name__,
            __base__=model,
            __module__=model.__module__,
            __doc__=model.__doc__,
            **option_fields(OPTIONS[kind]),
        )
        return cast("ModelT", made)

    return add


def option_fields(declared: Sequence[Declared]) -> dict[str, Any]:
    """Return the fields of a model for options."""
    return {one["name"]: (_type(one), Field(one["default"], description=one["text"])) for one in declared}


def _type(said: Declared) -> Any:
    """Type of an option: one of its choices, or a number, a list of numbers or of lists, or nothing."""
    if "choices" in said:
        choices: Any = Literal[tuple(said["choices"])]
        return choices | None if said.get("null") else choices
    number: Any = NUMBERS[said["number"]]
    limits = said.get("limits", {})
    if "unit" in said:
        number = Annotated[number, unit(said["unit"], **limits)]
    elif limits:
        number = Annotated[number, Field(**limits)]
    forms = {"number": number, "list": list[number], "lists": list[list[number]], "null": None}
    return reduce(or_, (forms[form] for form in said["forms"]))
