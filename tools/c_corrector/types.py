"""Types of the kernels' variables in C: what numba infers, inferred here for the little Python that kernels are written in.

A type is "double", "int", "bool", "rows" (the program, which knows its length), "matrix" (rows of COLUMNS numbers),
"row" (a row of numbers), "const row", or "tuple N" (N numbers).
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field

# One name, one meaning in every kernel, so a parameter's name says its type; whatever is not here is an index or a count.
PARAMETERS: Mapping[str, str] = {
    **dict.fromkeys(("P",), "rows"),
    **dict.fromkeys(("W", "state"), "matrix"),
    **dict.fromkeys(("info", "out"), "row"),
    "direction": "const row",
    **dict.fromkeys(("A", "B", "T", "wanted", "actual"), "tuple 12"),
    **dict.fromkeys(("w", "dw", "a", "f", "t", "d", "rotation", "none", "half", "whole"), "tuple 3"),
    **dict.fromkeys(
        ("lines", "dynamic", "warm", "own", "sided", "near", "fresh", "stops", "ramping", "started"), "bool"
    ),
    **dict.fromkeys(
        ("m", "n", "oj", "og", "S", "k", "j", "i", "c", "at", "row", "rows", "width", "rounds", "ride"), "int"
    ),
    **dict.fromkeys(("first", "last", "flags", "before", "aim", "column"), "int"),
}
# Where a name means something else: by function.
EXCEPTIONS: Mapping[tuple[str, str], str] = {
    **{(function, "c"): "double" for function in ("rotated_z", "sine_cosine_near")},
    **{(function, "d"): "double" for function in ("shifted_z", "sine_cosine_near")},
    **{(function, "a"): "double" for function in ("_soft_saturation", "_is_sign_softened")},
    **{(function, "x"): "const row" for function in ("_setpoint_status", "_motion", "correct_setpoint", "correct_row")},
    **{(function, "x"): "const row" for function in ("feed_forward", "_move_outward")},
    ("_soft_sign", "width"): "double",
    ("_rate_limited", "last"): "double",
}


class TranslationError(ValueError):
    """The kernel uses something that this translation does not know."""


def parameter(function: str, name: str) -> str:
    """Type of a parameter."""
    return EXCEPTIONS.get((function, name)) or PARAMETERS.get(name, "double")


@dataclass
class Scope:
    """Types by name: of the constants, of what the functions return, and of the variables of the function at hand.

    ``variables`` are the names of all variables of all functions.
    """

    constants: Mapping[str, str]
    variables: frozenset[str]
    returns: dict[str, str] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)

    def of(self, node: ast.expr) -> str:
        """Type of an expression.

        Raises:
            TranslationError: it is not known.

        """
        match node:
            case ast.Constant(value=bool()):
                return "bool"
            case ast.Constant(value=int()):
                return "int"
            case ast.Constant(value=float()):
                return "double"
            case ast.Name(id=name):
                return self._named(name, node)
            case ast.Attribute(value=ast.Name(id="math")):
                return "double"
            case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                return "bool"
            case ast.UnaryOp(operand=operand):
                return self.of(operand)
            case ast.BinOp(op=ast.Div()):
                return "double"
            case ast.BinOp(left=left, right=right):
                return "double" if "double" in (self.of(left), self.of(right)) else "int"
            case ast.IfExp(body=body, orelse=other):
                return "double" if "double" in (self.of(body), self.of(other)) else self.of(body)
            case ast.Tuple(elts=parts):
                return f"tuple {len(parts)}"
            case ast.Subscript(value=ast.Attribute(attr="shape")):
                return "int"
            case ast.Subscript(value=value, slice=place):
                return self._part(self.of(value), place)
            case ast.Call(func=func):
                return self._call(func, node)
        raise TranslationError(f"line {node.lineno}: {ast.unparse(node)}")

    def _named(self, name: str, node: ast.expr) -> str:
        found = self.names.get(name) or self.constants.get(name)
        if found is None:
            raise TranslationError(f"line {node.lineno}: {name} has no type")
        return found

    def _part(self, whole: str, place: ast.expr) -> str:
        if whole in ("matrix", "rows") and not isinstance(place, ast.Tuple):
            return "row"
        return "double"

    def _call(self, func: ast.expr, node: ast.Call) -> str:
        match func:
            case ast.Attribute(value=ast.Name(id="math")):
                return "double"
            case ast.Name(id="int" | "len"):
                return "int"
            case ast.Name(id="abs"):
                return self.of(node.args[0])
            case ast.Name(id="min" | "max"):
                return "double"
            case ast.Name(id=name) if name in self.returns:
                return self.returns[name]
        raise TranslationError(f"line {node.lineno}: call of {ast.unparse(func)}")
