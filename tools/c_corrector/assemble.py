"""Put the C file together: licence, constants of the layout, the kernels in order, and what the outside calls."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType

from kilter_core.arm.kernels import se3
from kilter_core.correct.file import layout_digest
from kilter_core.correct.kernels import chain, effects, inverse, layout, newton_euler, rates, solver, stream
from kilter_core.motion.kernels import torque
from tools.c_corrector.translate import Function, wrapped
from tools.c_corrector.types import Scope

# In the order in which C wants them: what is called stands before its callers.
MODULES = (se3, chain, newton_euler, effects, solver, inverse, rates, stream)
# Entries that work on whole arrays of numpy: in C, :file:`public.c` has their place.
LEFT_OUT = ("step", "follow", "correct_rows")
# A sum beside a difference of products, which GCC makes one instruction of: tests/core/correct/test_c_corrector.py finds them.
SCALAR = ("sine_cosine_near",)
FOLDER = Path(__file__).parent


def assembled() -> dict[str, str]:
    """Name -> text of the C file and its header."""
    parts = [(FOLDER / "head.c").read_text(), _defined(_layout(), "Places in the memory, and flags.")]
    parts += [*_kernels(MODULES, _layout()), (FOLDER / "public.c").read_text()]
    header = (FOLDER / "corrector.h").read_text().replace("@LAYOUT@", f"0x{layout_digest():08x}u")
    header = re.sub(r"@(\w+)@", lambda found: str(_layout()[found[1]]), header)
    torques = (FOLDER / "torque.c").read_text().replace("@KERNELS@", "\n".join(_kernels((torque,), {})))
    return {"kilter_corrector.c": "\n".join(parts), "kilter_corrector.h": header, "kilter_torque.c": torques}


def _kernels(modules: Sequence[ModuleType], known: Mapping[str, float]) -> Iterator[str]:
    """Modules as C, where some constants are known."""
    sources = {module: Path(str(module.__file__)).read_text() for module in modules}
    constants = {module: _constants(sources[module]) for module in modules}
    everything = {**known, **{name: value for of in constants.values() for name, value in of.items()}}
    kinds = {name: type(value).__name__.replace("float", "double") for name, value in everything.items()}
    scope = Scope(kinds, frozenset().union(*(_variables(source) for source in sources.values())))
    for module in modules:
        title = module.__name__.removeprefix("kilter_core.").replace(".kernels.", "/")
        yield f"/* ---- {title} {'-' * (100 - len(title))} */\n"
        if constants[module]:
            yield _defined(constants[module], "")
        yield from _functions(sources[module], scope)


def _layout() -> dict[str, float]:
    return {name: value for name, value in vars(layout).items() if name.isupper()}


def _constants(source: str) -> dict[str, float]:
    """Numbers in capitals that a module assigns."""
    found: dict[str, float] = {}
    for node in ast.parse(source).body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name.isupper():
                found[name] = ast.literal_eval(value)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                for target, value in zip(targets, values, strict=True):
                    found[target.id] = ast.literal_eval(value)  # type: ignore[attr-defined]
    return found


def _defined(constants: Mapping[str, float], comment: str) -> str:
    whole = [f"{name} = {value}" for name, value in constants.items() if isinstance(value, int)]
    lines = [f"/* {comment} */"] if comment else []
    if whole:
        lines += ["enum {", *wrapped("    " + ", ".join(whole), 0), "};"]
    lines += [f"#define {name} {value!r}" for name, value in constants.items() if isinstance(value, float)]
    return "\n".join([*lines, ""])


def _comments(source: str) -> dict[int, str]:
    """Comments by line; one beside code begins with a blank."""
    found = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            found[token.start[0]] = token.string if token.line.lstrip().startswith("#") else " " + token.string
    return found


def _variables(source: str) -> set[str]:
    """Names that functions assign or take."""
    stored = {n.id for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    return stored | {n.arg for n in ast.walk(ast.parse(source)) if isinstance(n, ast.arg)}


def _functions(source: str, scope: Scope) -> list[str]:
    comments = _comments(source)
    nodes = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}
    done: dict[str, str] = {}

    def add(name: str) -> None:
        calls = (part.func for part in ast.walk(nodes[name]) if isinstance(part, ast.Call))
        called = {func.id for func in calls if isinstance(func, ast.Name) and func.id in nodes}
        for other in sorted(called, key=list(nodes).index):
            if other not in done:
                add(other)
        text = Function(nodes[name], scope, comments).translated()
        done[name] = f"SCALAR\n{text}SCALAR_END\n" if name in SCALAR else text

    for name in nodes:
        if name not in done and name not in LEFT_OUT:
            add(name)
    return list(done.values())
