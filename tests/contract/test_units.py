"""Units are converted once, at the edge: in `wire.py`, where files are read and written, and in the robot document."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
CALLS = {"degrees", "radians", "rad2deg", "deg2rad"}
FACTORS = {1e3, 1e-3, 180.0}
TABLES = {"MM", "DEG", "WIRE"}  # factors and tables of factors by name
# What reads and writes files of mm and degrees, and the robot document, which people write in them.
AT_THE_EDGE = (
    "service/kilter_service/**/wire.py",
    "service/kilter_service/ground/wire.py",
    "service/kilter_service/robots/importers/*.py",
    "service/kilter_service/robots/exporters/*.py",
    "service/kilter_service/contract/columns.py",
    "service/kilter_service/ground/tables/assemble.py",
    "service/kilter_service/campaigns/row_rules.py",
    "service/kilter_service/versions/predictions/differences.py",
    "core/kilter_core/arm/documents/*.py",
    "core/kilter_core/arm/conversions/*.py",
    "core/kilter_core/parameters.py",  # where the core has its functions for it
)
# Times, in nanoseconds, microseconds and milliseconds.
NO_LENGTHS = ("service/kilter_service/stream/corrector/fast_path.py",)
# Where the core converts by itself: options whose names are promised, factors that data are tried with, and the simulated
# arm's data. Number of lines; only ever fewer.
STILL = {
    "core/kilter_core/gap/evidence/held_out/held_out_errors.py": 1,
    "core/kilter_core/gap/evidence/held_out/practical_size.py": 1,
    "core/kilter_core/gap/report/next_poses.py": 1,
    "core/kilter_core/gap/report/separation.py": 1,
    "core/kilter_core/gap/search/sources/source.py": 1,
    "core/kilter_core/gap/search/noise_reader.py": 1,
    "core/kilter_core/identify/identifiability.py": 2,
    "core/kilter_core/identify/comparison.py": 1,
    "core/kilter_core/identify/options.py": 3,
    "core/kilter_core/identify/plausibility/belonging.py": 1,
    "core/kilter_core/identify/plausibility/mix_ups.py": 3,
    "core/kilter_core/identify/uncertainty/predictive.py": 2,
    "core/kilter_core/procedures/circle_points.py": 1,
}
MOST_REPORTING = 71  # modules of the core with sentences or reports in mm and degrees, each of one check or report
SHARES = (
    "core/kilter_core/plan/d_optimal.py",
    "core/kilter_core/gap/noise/variogram.py",
)  # a thousandth of something, no millimetre


def constant(node: ast.AST) -> bool:
    """Whether an expression is made of numbers alone, as a constant in rad that is written in degrees."""
    parts = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop, ast.expr_context)
    return all(
        isinstance(part, parts)
        or (isinstance(part, ast.Attribute | ast.Name) and ast.unparse(part) in ("math", "np", "math.pi", "np.pi"))
        for part in ast.walk(node)
    )


def conversions(node: ast.AST) -> Iterator[int]:
    """Lines that convert a length or an angle; numbers in sentences for people are none."""
    if isinstance(node, ast.JoinedStr):
        return
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CALLS:
        if not all(constant(argument) for argument in node.args):
            yield node.lineno
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        sides = [side.value for side in (node.left, node.right) if isinstance(side, ast.Constant)]
        if FACTORS & set(sides) and not constant(node):
            yield node.lineno
    elif isinstance(node, ast.Name) and node.id in TABLES:
        yield node.lineno
    for child in ast.iter_child_nodes(node):
        yield from conversions(child)


@cache
def found() -> dict[str, int]:
    edge = {path for pattern in AT_THE_EDGE for path in REPOSITORY.glob(pattern)}
    out = {}
    for folder in ("core", "service"):
        for path in sorted((REPOSITORY / folder).rglob("*.py")):
            name = path.relative_to(REPOSITORY).as_posix()
            lines = set(conversions(ast.parse(path.read_text(encoding="utf-8"))))
            if lines and path not in edge and name not in (*NO_LENGTHS, *SHARES):
                out[name] = len(lines)
    return out


def test_units_are_converted_at_the_edge_only() -> None:
    more = {name: count for name, count in found().items() if count > STILL.get(name, 0)}
    assert not more, "convert in wire.py"


def test_few_modules_of_the_core_report_in_mm_and_degrees() -> None:
    core = (REPOSITORY / "core").rglob("*.py")
    functions = re.compile(r"^from kilter_core\.parameters import .*\b(?:mm|degrees|metres|reported|MM|DEG)\b", re.M)
    assert sum(bool(functions.search(path.read_text(encoding="utf-8"))) for path in core) <= MOST_REPORTING


def test_what_no_longer_converts_is_taken_off_the_list() -> None:
    now = found()
    assert {name: count for name, count in STILL.items() if now.get(name, 0) < count} == {}


@pytest.mark.parametrize(
    ("text", "converts"),
    [
        ("x = np.degrees(q)", True),
        ("x = length * 1e3", True),
        ("x = 1e-3 * noise_mm", True),
        ("x = angle * 180.0 / math.pi", True),
        ("x = length * MM", True),
        ("LIMIT = math.radians(170.0)", False),
        ("NEAR = 180.0 / math.pi", False),
        ("said = f'{length * 1e3:.3g} mm'", False),
        ("x = length * 2.0", False),
    ],
)
def test_a_conversion_is_found(text: str, converts: bool) -> None:
    assert bool(list(conversions(ast.parse(text)))) is converts
