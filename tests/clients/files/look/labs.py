"""Files of invented labs: the same measurements of one arm, each written down in another way."""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from openpyxl import Workbook
from pyarrow import parquet
from scipy.io import savemat

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """Joints in deg (n, 5), points in mm (n, 3)."""

    q: Floats
    p: Floats


@dataclass(frozen=True)
class Lab:
    """How a lab writes its file, and what a person fills in where the draft is marked: old text -> new text."""

    ending: str
    write: Callable[[Path, Measured], None]
    filled: tuple[tuple[str, str], ...] = ()
    open: tuple[str, ...] = ()


def _german(path: Path, m: Measured) -> None:
    names, units = [f"Achse {k}" for k in range(1, 6)], ["[°]"] * 5
    head = ["Prüfling;Messung 17", "Datum;22.11.2026", "", ";".join(["Nr", *names, "X-Ist", "Y-Ist", "Z-Ist", "Größe"])]
    head.append(";".join(["", *units, "[mm]", "[mm]", "[mm]", ""]))
    numbers = [";".join(f"{v:.6f}".replace(".", ",") for v in (*q, *p)) for q, p in zip(m.q, m.p, strict=True)]
    rows = [f"{k};{text};ok" for k, text in enumerate(numbers)]
    path.write_bytes(("\n".join([*head, *rows]) + "\n").encode("latin-1"))


def _kuka(path: Path, m: Measured) -> None:
    """A log with torques and commanded points beside what was measured, and time stamps kept as text."""
    names = [*(f"A{k}" for k in range(1, 6)), *(f"torque_{k}" for k in range(1, 6))]
    names += [*(f"{a}_cmd" for a in "xyz"), *(f"{a}_meas" for a in "xyz"), "A", "B", "C"]
    rows = ["# log of the controller", ",".join(["Timestamp", *names])]
    for k, (q, p) in enumerate(zip(m.q, m.p, strict=True)):
        values = (*q, *(0.1 * q), *(p + 3), *p, 10.0, 20.0, -170.0)
        rows.append(f"'12:{k // 60:02d}:{k % 60:02d}.5," + ",".join(f"{v:.7f}" for v in values))
    path.write_text("\n".join(rows) + "\n")


def _lists(path: Path, m: Measured) -> None:
    """A script's output: a joint vector in one cell, over several lines."""
    rows = ["pose,joint_positions,tcp_position,state"]
    for k, (q, p) in enumerate(zip(np.radians(m.q), m.p / 1000, strict=True)):
        joints = json.dumps(q.tolist()).replace(", ", ",\n  ")
        rows.append(f'{k // 2},"{joints}","{np.array2string(p, precision=9)}",{"ok" if k % 9 else "bad"}')
    path.write_text("\n".join(rows) + "\n")


def _workbook(path: Path, m: Measured) -> None:
    book = Workbook()
    assert book.active is not None
    book.active.title = "Deckblatt"
    book.active.append(["Messprotokoll", "für den Greifer"])
    sheet = book.create_sheet("Messung Süd")
    sheet.append(["gemessen am Montag"])
    names = [*(f"Gelenk {k} (rad)" for k in range(1, 6)), *(f"Position\n{a} (mm)" for a in "XYZ")]
    sheet.append([*names, "Uhrzeit", "Last (g)"])
    start = datetime.datetime(2026, 11, 22, 8, 0, 0)
    for k, (q, p) in enumerate(zip(np.radians(m.q), m.p, strict=True)):
        sheet.append([*q.tolist(), *p.tolist(), start + datetime.timedelta(seconds=7 * k), 2500])
    book.save(path)


def _matlab(path: Path, m: Measured) -> None:
    savemat(path, {"log": {"q": np.radians(m.q)}, "pos": m.p / 1000, "t": np.arange(len(m.q), dtype=np.float64)})


def _parquet(path: Path, m: Measured) -> None:
    places = {f"tracker_{a}_m": m.p[:, k] / 1000 for k, a in enumerate("xyz")}
    parquet.write_table(pa.table({"joint_states": np.radians(m.q).tolist(), **places}), path)


def _plain(path: Path, m: Measured) -> None:
    """No units, no joint names that say so, points without a unit that are large."""
    rows = ["\t".join(["base", "shoulder", "arm", "pitch", "roll", "px", "py", "pz"])]
    rows += ["\t".join(f"{v:.6f}" for v in (*q, *p)) for q, p in zip(m.q, m.p, strict=True)]
    path.write_text("\n".join(rows) + "\n")


def _blanks(path: Path, m: Measured) -> None:
    rows = ["% joint log", "j0 j1 j2 j3 j4 X Y Z"]
    rows += [" ".join(f"{v:10.6f}" for v in (*q, *p)) for q, p in zip(m.q / 360.0, m.p / 25.4, strict=True)]
    path.write_text("\n".join(rows) + "\n")


PLAIN_JOINTS = "\n".join(
    f'q{k}_deg = {{ from = "{name}", unit = "deg" }}'
    for k, name in enumerate(("base", "shoulder", "arm", "pitch", "roll"), 1)
)
LABS: dict[str, Lab] = {
    "german": Lab(".csv", _german),
    "kuka": Lab(".csv", _kuka),
    "lists": Lab(".csv", _lists),
    "workbook": Lab(".xlsx", _workbook),
    "matlab": Lab(".mat", _matlab),
    "parquet": Lab(".parquet", _parquet),
    "plain": Lab(".txt", _plain, (('"q*" = { from = "?", unit = "?" }', PLAIN_JOINTS),), ("columns.q*",)),
    "blanks": Lab(
        ".dat", _blanks,
        (('"q*" = { from = "j*", unit = "rad" }', '"q*" = { from = "j*", unit = "turn" }'), ('unit = "?"', 'unit = "inch"')),
        ("columns.x_mm", "columns.y_mm", "columns.z_mm"),
    ),
}  # fmt: skip


def write_lab(folder: Path, name: str, measured: Measured | None = None) -> tuple[Path, Measured]:
    """Write the file of a lab; without measurements those of an invented arm."""
    if measured is None:
        rng = np.random.default_rng(3)
        q = np.repeat(rng.uniform(-110, 110, (12, 5)), 2, axis=0)
        measured = Measured(q, rng.uniform(-450, 450, (24, 3)))
    path = folder / f"{name} Maße{LABS[name].ending}"
    LABS[name].write(path, measured)
    return path, measured
