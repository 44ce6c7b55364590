"""A kernel as a C function: statement by statement, with its docstring and its comments."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from tools.c_corrector.types import Scope, TranslationError, parameter

WIDTH = 120
_MATH = {"inf": "INFINITY", "nan": "NAN", "pi": "3.14159265358979323846"}
_OPERATORS: Mapping[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.BitAnd: "&", ast.BitOr: "|", ast.LShift: "<<",
    ast.RShift: ">>", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
# How strongly C binds: an operand that binds less than its operator is put in parentheses.
_STRENGTH = {"*": 9, "/": 9, "+": 8, "-": 8, "<<": 7, ">>": 7, "<": 6, "<=": 6, ">": 6, ">=": 6, "==": 5, "!=": 5}
ATOM, UNARY, BITS, AND, OR, CHOICE = 12, 10, 4, 3, 2, 1


def c_type(kind: str) -> str:
    """A type as C declares it, up to the name."""
    if kind.startswith("tuple "):
        return f"tuple{kind[6:]} "
    return {
        "rows": "rows ", "matrix": "matrix ", "row": "double *", "const row": "const double *",
    }.get(kind, kind + " ")  # fmt: skip


def c_name(name: str, scope: Scope) -> str:
    """Name of a function in C: all of the file is private; a variable of the same name would hide it."""
    plain = name.lstrip("_")
    return f"{plain}_of" if plain in scope.variables else plain


@dataclass
class Function:
    """A kernel on its way to C."""

    node: ast.FunctionDef
    scope: Scope
    comments: Mapping[int, str]
    lines: list[str] = field(default_factory=list)
    declared: set[str] = field(default_factory=set)
    temporaries: int = 0

    @property
    def name(self) -> str:
        """The name in C."""
        return c_name(self.node.name, self.scope)

    def translated(self) -> str:
        """The whole function."""
        kinds = {a.arg: parameter(self.node.name, a.arg) for a in self.node.args.args}
        self.scope.names = dict(kinds)
        self.declared = set(kinds)
        body = self.node.body[1:] if ast.get_docstring(self.node) else self.node.body
        self._infer(body)
        returned = self.scope.returns[self.node.name] = self._returned(body)
        arguments = ", ".join(c_type(kind) + name for name, kind in kinds.items())
        head = f"static {c_type(returned)}{self.name}({arguments})"
        used = set(names_of(ast.Module(body, [])))
        for name in kinds:
            if name not in used:
                self._emit(f"(void){name};", 1)
        self._block(body, 1)
        return "\n".join([*self._docstring(), *wrapped(head, 0), "{", *self.lines, "}", ""])

    def _docstring(self) -> list[str]:
        text = " ".join((ast.get_docstring(self.node) or "").replace("``", "").replace(":func:", "").split())
        return wrapped(f"/* {text} */", 0, hanging=" * ")

    def _infer(self, body: Sequence[ast.stmt]) -> None:
        """Types of all local variables, from what is first assigned to them; an int that is given a double is one."""
        for node in ast.walk(ast.Module(list(body), [])):
            if isinstance(node, ast.For):
                self._infer_loop(node)
        for _ in range(4):  # a variable may be made of ones that stand later in the walk
            for node in ast.walk(ast.Module(list(body), [])):
                if isinstance(node, ast.Assign):
                    for target in node.targets:
                        self._infer_target(target, node.value)
                elif isinstance(node, ast.AugAssign):
                    self._infer_target(node.target, ast.BinOp(node.target, node.op, node.value))

    def _infer_loop(self, node: ast.For) -> None:
        match node.target:
            case ast.Name(id=name):
                self.scope.names[name] = "int"
            case ast.Tuple(elts=[ast.Name(id=place), ast.Name(id=value)]):
                self.scope.names[place], self.scope.names[value] = "int", "double"

    def _infer_target(self, target: ast.expr, value: ast.expr) -> None:
        match target, value:
            case ast.Name(id=name), _:
                try:
                    kind = self.scope.of(value)
                except TranslationError:
                    return
                if self.scope.names.get(name) in (None, "int") or kind == "double":
                    self.scope.names[name] = kind
            case ast.Tuple(elts=targets), ast.Tuple(elts=values):
                for one, part in zip(targets, values, strict=True):
                    self._infer_target(one, part)
            case ast.Tuple(elts=targets), _:
                for one in targets:
                    if isinstance(one, ast.Name):
                        self.scope.names.setdefault(one.id, "double")

    def _returned(self, body: Sequence[ast.stmt]) -> str:
        kinds = [
            self.scope.of(node.value)
            for node in ast.walk(ast.Module(list(body), []))
            if isinstance(node, ast.Return) and node.value is not None
        ]
        return "void" if not kinds else "double" if "double" in kinds else kinds[0]

    def _block(self, body: Sequence[ast.stmt], depth: int) -> None:
        for place, statement in enumerate(body):
            for name in self._to_declare(body, place):
                self._declare(name, depth)
            self._comment(statement, depth)
            self._statement(statement, depth)

    def _to_declare(self, body: Sequence[ast.stmt], place: int) -> list[str]:
        """Locals whose scope this block is and which the statement does not itself declare."""
        used = names_of(body[place])
        rest = set().union(*(names_of(other) for other in body[place + 1 :]))
        itself = self._declares(body[place])
        fresh = [name for name in used if name in self.scope.names and name not in self.declared]
        if isinstance(body[place], (ast.If, ast.While, ast.For)):
            inner = set(loop_names(body[place]))
            own = [name for name in fresh if name in rest or (name not in inner and spread(body[place], name))]
            return [name for name in own if name not in itself]
        return [name for name in fresh if name not in itself]

    def _declares(self, statement: ast.stmt) -> set[str]:
        """What a statement can declare where it stands."""
        match statement:
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name not in names_of(value):
                return {name}
            case ast.Assign(targets=[ast.Tuple(elts=targets)]):
                return {t.id for t in targets if isinstance(t, ast.Name)}
        return set()

    def _declare(self, name: str, depth: int) -> None:
        kind = self.scope.names[name]
        start = {"double": "0.0", "int": "0", "bool": "false"}.get(kind, "{{0.0}}")
        self._emit(f"{c_type(kind)}{name} = {start};", depth)
        self.declared.add(name)

    def _comment(self, statement: ast.stmt, depth: int) -> None:
        line = statement.lineno - 1
        above = []
        while line in self.comments and self.comments[line].startswith("#"):
            above.append(self.comments[line])
            line -= 1
        texts = [text.lstrip("# ") for text in reversed(above)]
        beside = self.comments.get(statement.lineno, "")
        if beside.startswith(" ") and "fmt:" not in beside:
            texts.append(beside.strip(" #"))
        if texts:
            self.lines += wrapped(f"/* {' '.join(texts)} */", depth, hanging=" * ")

    def _emit(self, text: str, depth: int) -> None:
        self.lines += wrapped(text, depth)

    def _statement(self, statement: ast.stmt, depth: int) -> None:
        match statement:
            case ast.Assign(targets=targets, value=value):
                self._assign(targets, value, depth)
            case ast.AugAssign(target=target, op=op, value=value):
                self._emit(f"{self._code(target)} {_OPERATORS[type(op)]}= {self._code(value)};", depth)
            case ast.Return(value=None):
                self._emit("return;", depth)
            case ast.Return(value=value) if value is not None:
                self._emit(f"return {self._code(value)};", depth)
            case ast.Break():
                self._emit("break;", depth)
            case ast.Expr(value=value):
                self._emit(f"{self._code(value)};", depth)
            case ast.If():
                self._if(statement, depth, "")
            case ast.While(test=test, body=body):
                self._emit(f"while ({self._code(test)}) {{", depth)
                self._inner(body, depth)
                self._emit("}", depth)
            case ast.For():
                self._for(statement, depth)
            case _:
                raise TranslationError(f"{self.node.name}, line {statement.lineno}: {ast.unparse(statement)}")

    def _inner(self, body: Sequence[ast.stmt], depth: int) -> None:
        """A block of its own: what it declares ends with it."""
        before = set(self.declared)
        self._block(body, depth + 1)
        self.declared = before

    def _if(self, statement: ast.If, depth: int, before: str) -> None:
        self._emit(f"{before}if ({self._code(statement.test)}) {{", depth)
        self._inner(statement.body, depth)
        match statement.orelse:
            case []:
                self._emit("}", depth)
            case [ast.If() as other] if not self._to_declare([other], 0):
                self._if(other, depth, "} else ")
            case other_body:
                self._emit("} else {", depth)
                self._inner(other_body, depth)
                self._emit("}", depth)

    def _for(self, statement: ast.For, depth: int) -> None:
        before = set(self.declared)
        match statement.target, statement.iter:
            case ast.Name(id=name), ast.Call(func=ast.Name(id="range"), args=arguments):
                kept = name in self.declared  # used after the loop, where Python keeps its last value
                place = f"{name}_at" if kept else name
                self.declared.add(name)
                self._emit(self._range(place, arguments), depth)
                if kept:
                    self._emit(f"{name} = {place};", depth + 1)
            case ast.Tuple(elts=[ast.Name(id=place), ast.Name(id=name)]), ast.Call(args=[ast.Tuple(elts=parts)]):
                each = f"each_{name}"
                values = ", ".join(self._code(part) for part in parts)
                self._emit(f"const double {each}[] = {{{values}}};", depth)
                self._emit(f"for (int {place} = 0; {place} < {len(parts)}; {place}++) {{", depth)
                self._emit(f"const double {name} = {each}[{place}];", depth + 1)
                self.declared |= {place, name}
            case _:
                raise TranslationError(f"{self.node.name}, line {statement.lineno}: {ast.unparse(statement)}")
        self._block(statement.body, depth + 1)
        self.declared = before
        self._emit("}", depth)

    def _range(self, place: str, arguments: Sequence[ast.expr]) -> str:
        first, last, step = "0", self._code(arguments[-1 if len(arguments) == 1 else 1]), 1
        if len(arguments) > 1:
            first = self._code(arguments[0])
        if len(arguments) > 2:
            step = ast.literal_eval(arguments[2])
        if step == -1:
            return f"for (int {place} = {first}; {place} > {last}; {place}--) {{"
        onward = f"{place}++" if step == 1 else f"{place} += {step}"
        return f"for (int {place} = {first}; {place} < {last}; {onward}) {{"

    def _assign(self, targets: Sequence[ast.expr], value: ast.expr, depth: int) -> None:
        if len(targets) == 1 and isinstance(targets[0], ast.Tuple):
            return self._unpack(targets[0].elts, value, depth)
        chain = "".join(f"{self._target(target)} = " for target in targets)
        return self._emit(f"{chain}{self._code(value)};", depth)

    def _target(self, target: ast.expr) -> str:
        """A place to assign to, declared where it is new."""
        if isinstance(target, ast.Name) and target.id not in self.declared:
            self.declared.add(target.id)
            return c_type(self.scope.names[target.id]) + target.id
        return self._code(target)

    def _unpack(self, targets: Sequence[ast.expr], value: ast.expr, depth: int) -> None:
        if not isinstance(value, ast.Tuple):
            whole = self._temporary()
            kind = self.scope.of(value)
            self._emit(f"const {c_type(kind)}{whole} = {self._code(value)};", depth)
            for place, target in enumerate(targets):
                if not (isinstance(target, ast.Name) and target.id == "_"):
                    self._emit(f"{self._target(target)} = {whole}.at[{place}];", depth)
            return
        pairs = list(zip(targets, value.elts, strict=True))
        texts = []
        for place, (target, part) in enumerate(pairs):
            text = self._code(part)
            # Python takes all values before it assigns any.
            if any(same_place(earlier, part) for earlier, _ in pairs[:place]):
                whole = self._temporary()
                self._emit(f"const {c_type(self.scope.of(part))}{whole} = {text};", depth)
                text = whole
            texts.append((target, text))
        for target, text in texts:
            self._emit(f"{self._target(target)} = {text};", depth)

    def _temporary(self) -> str:
        self.temporaries += 1
        return f"got{self.temporaries}"

    def _code(self, node: ast.expr) -> str:
        return self._expression(node)[0]

    def _expression(self, node: ast.expr) -> tuple[str, int]:
        """An expression in C, and how strongly it binds."""
        match node:
            case ast.Constant(value=bool() as value):
                return ("true" if value else "false"), ATOM
            case ast.Constant(value=value):
                return repr(value), ATOM
            case ast.Name(id=name):
                return name.lstrip("_"), ATOM
            case ast.Attribute(value=ast.Name(id="math"), attr=name):
                return _MATH[name], ATOM
            case ast.Subscript(value=ast.Attribute(value=ast.Name(id=name), attr="shape")):
                return f"{name}.count", ATOM
            case ast.Subscript():
                return self._subscript(node), ATOM
            case ast.Tuple(elts=parts):
                return f"(tuple{len(parts)}){{{{{', '.join(self._code(part) for part in parts)}}}}}", ATOM
            case ast.UnaryOp(op=op, operand=operand):
                sign = {ast.USub: "-", ast.Not: "!", ast.Invert: "~"}[type(op)]
                return sign + self._bound(operand, UNARY + 1), UNARY
            case ast.BinOp():
                return self._binary(node)
            case ast.BoolOp(op=op, values=values):
                sign, strength = ("&&", AND) if isinstance(op, ast.And) else ("||", OR)
                # gcc asks for parentheses around && within ||.
                return f" {sign} ".join(self._bound(value, AND + 1) for value in values), strength
            case ast.Compare():
                return self._compare(node)
            case ast.IfExp(test=test, body=body, orelse=other):
                test_code = self._bound(test, CHOICE + 1)
                return f"{test_code} ? {self._bound(body, CHOICE + 1)} : {self._code(other)}", CHOICE
            case ast.Call():
                return self._call(node)
        raise TranslationError(f"{self.node.name}, line {node.lineno}: {ast.unparse(node)}")

    def _bound(self, node: ast.expr, least: int) -> str:
        code, strength = self._expression(node)
        return code if strength >= least else f"({code})"

    def _subscript(self, node: ast.Subscript) -> str:
        kind = self.scope.of(node.value)
        whole = self._code(node.value)
        if kind == "rows":
            whole += ".at"
        if kind.startswith("tuple"):
            return f"{whole}.at[{self._code(node.slice)}]"
        if isinstance(node.slice, ast.Tuple):
            return whole + "".join(f"[{self._code(part)}]" for part in node.slice.elts)
        return f"{whole}[{self._code(node.slice)}]"

    def _binary(self, node: ast.BinOp) -> tuple[str, int]:
        if isinstance(node.op, ast.Pow):
            if not (isinstance(node.right, ast.Constant) and node.right.value == 2):
                raise TranslationError(f"{self.node.name}, line {node.lineno}: a power other than 2")
            return f"squared({self._code(node.left)})", ATOM
        sign = _OPERATORS[type(node.op)]
        if sign in "&|":  # a chain of one sign needs no parentheses, a mixture does
            chain = isinstance(node.left, ast.BinOp) and type(node.left.op) is type(node.op)
            return f"{self._bound(node.left, BITS if chain else UNARY)} {sign} {self._bound(node.right, UNARY)}", BITS
        strength = _STRENGTH[sign]
        left = self._bound(node.left, strength)
        if sign == "/" and self.scope.of(node.left) != "double" and self.scope.of(node.right) != "double":
            left = f"(double){self._bound(node.left, UNARY)}"
        return f"{left} {sign} {self._bound(node.right, strength + 1)}", strength

    def _compare(self, node: ast.Compare) -> tuple[str, int]:
        parts = [node.left, *node.comparators]
        texts = []
        for place, op in enumerate(node.ops):
            texts.append(
                f"{self._bound(parts[place], _STRENGTH['<<'])} {_OPERATORS[type(op)]} "
                f"{self._bound(parts[place + 1], _STRENGTH['<<'])}"
            )
        return (texts[0], _STRENGTH["=="]) if len(texts) == 1 else (" && ".join(texts), AND)

    def _call(self, node: ast.Call) -> tuple[str, int]:
        arguments = [self._code(argument) for argument in node.args]
        match node.func:
            case ast.Attribute(value=ast.Name(id="math"), attr=name):
                return f"{name}({', '.join(arguments)})", ATOM
            case ast.Name(id="int"):
                return f"(int){self._bound(node.args[0], UNARY)}", UNARY
            case ast.Name(id="abs"):
                name = "fabs" if self.scope.of(node.args[0]) == "double" else "abs"
                return f"{name}({arguments[0]})", ATOM
            case ast.Name(id="min" | "max" as name):
                first, second = arguments
                return f"{'smaller' if name == 'min' else 'larger'}({first}, {second})", ATOM
            case ast.Name(id=name):
                return f"{c_name(name, self.scope)}({', '.join(arguments)})", ATOM
        raise TranslationError(f"{self.node.name}, line {node.lineno}: {ast.unparse(node)}")


def wrapped(text: str, depth: int, hanging: str = "    ") -> list[str]:
    """A line of C, broken at spaces where it is too long."""
    indent = "    " * depth
    lines, rest = [], text
    first = indent
    while len(first) + len(rest) > WIDTH:
        room = WIDTH - len(first) + 1
        cut = rest.rfind(", ", room // 2, room) + 1 or rest.rfind(" ", 0, room)
        if cut <= 0:
            break
        lines.append(first + rest[:cut])
        rest = rest[cut + 1 :]
        first = indent + hanging
    return [*lines, first + rest]


def names_of(node: ast.AST) -> list[str]:
    """Names in the order of their appearance, each once."""
    return list(dict.fromkeys(part.id for part in in_order(node) if isinstance(part, ast.Name)))


def in_order(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes as they stand in the source."""
    yield node
    for child in ast.iter_child_nodes(node):
        yield from in_order(child)


def loop_names(statement: ast.stmt) -> list[str]:
    """Names that a loop gives its values."""
    return names_of(statement.target) if isinstance(statement, ast.For) else []


def spread(statement: ast.stmt, name: str) -> bool:
    """Whether a name lives in more than one block of a statement, or from one pass of a loop to the next."""
    match statement:
        case ast.If(test=test, body=body, orelse=other):
            places = [names_of(test), *[[n for s in block for n in names_of(s)] for block in (body, other)]]
            if sum(name in place for place in places) > 1:
                # An elif chain or two branches that each assign it first may declare it each.
                return name in places[0] or not all(assigned_first(block, name) for block in (body, other) if block)
            return not all(assigned_first(block, name) for block in (body, other) if block)
        case ast.While(test=head, body=body) | ast.For(iter=head, body=body):
            return name in names_of(head) or not assigned_first(body, name)
    return False


def assigned_first(body: Sequence[ast.stmt], name: str) -> bool:
    """Whether the first thing that a block does with a name is to assign it."""
    for statement in body:
        if name not in names_of(statement):
            continue
        match statement:
            case ast.Assign(targets=targets, value=value):
                return name not in names_of(value) and any(
                    name in [n.id for n in (t.elts if isinstance(t, ast.Tuple) else [t]) if isinstance(n, ast.Name)]
                    for t in targets
                )
            case ast.For() | ast.If() | ast.While():
                if name in loop_names(statement):
                    return True
                later = body[list(body).index(statement) + 1 :]
                if any(name in names_of(other) for other in later):
                    return False
                return not spread(statement, name)
        return False
    return True


def same_place(target: ast.expr, value: ast.expr) -> bool:
    """Whether assigning the target would change what the value is made of."""
    if isinstance(target, ast.Name):
        return target.id in names_of(value)
    text = ast.unparse(target)
    return any(ast.unparse(part) == text for part in ast.walk(value) if isinstance(part, ast.Subscript))
