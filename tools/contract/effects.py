"""The contract's module of effects, from the core's: the API process must say what they are without numpy."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import Field, fields
from typing import Any

from kilter_core.effects import EFFECTS, Effect

MADE = "made from core/kilter_core/effects by `make contract`: change them there."
HEAD = '''"""Effects {where} with their options, {made}"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.units import {imported}


class {base}(Asked):
    joints: {joints}
'''
AT_JOINTS = """Annotated[list[JointNumber], Field(min_length=1, max_length=32)] | None = Field(
        None, description="{text}"
    )
"""
WHOLE = """None = Field(None, description="Null: the effect does not act at joints.")
"""
UNION_HEAD = '''"""The effects by name and as documents, {made}"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from kilter_service.contract.effect_options import ({models})
from kilter_service.contract.whole_effect_options import ({whole})

'''
UNITS = {"_nm": "N m", "_c": "degC", "_s": "s", "_m": "m", "_rad": "rad", "_kg": "kg"}
LIMITS = {"low": "ge", "above": "gt", "high": "le"}


def options_module() -> str:
    """Return the text of the module with the options of the effects at joints."""
    text = next(f.metadata["text"] for f in fields(Effect) if f.name == "joints")
    head = HEAD.format(
        where="at joints",
        made=MADE,
        base="_AtJoints",
        joints=AT_JOINTS.format(text=text),
        imported="Asked, JointNumber, unit",
    )
    return head + "".join(_model(kind) for kind in EFFECTS.values() if kind.at_joints)


def whole_options_module() -> str:
    """Return the text of the module with those of the others."""
    imported = "Asked, JointNumber, unit"
    head = HEAD.format(where="on the whole arm", made=MADE, base="_Whole", joints=WHOLE, imported=imported)
    return head + "".join(_model(kind) for kind in EFFECTS.values() if not kind.at_joints)


def effects_module() -> str:
    """Return the text of the module that puts them together."""

    def listed(at_joints: bool) -> str:
        names = sorted(f"{kind.__name__}Effect" for kind in EFFECTS.values() if kind.at_joints == at_joints)
        return "\n" + "\n".join(_packed(", ".join(names) + ",")) + "\n"

    return UNION_HEAD.format(made=MADE, models=listed(True), whole=listed(False)) + "\n".join(_lines())


def _model(kind: type[Effect]) -> str:
    summary = f"{kind.summary[0].upper()}{kind.summary[1:]}."
    lines = [
        f"\n\nclass {kind.__name__}Effect({'_AtJoints' if kind.at_joints else '_Whole'}):",
        f'    """{summary}"""\n',
        f'    id: Literal["{kind.id}"] = Field(description="Id of the effect.")',
        *(_option(kind, one) for one in fields(kind) if one.name != "joints"),
    ]
    return "\n".join(lines) + "\n"


def _option(kind: type[Effect], one: Field[Any]) -> str:
    wire, default = _type(kind, one), one.default
    if isinstance(default, tuple):
        default = list(default)
    if "choices" in one.metadata:
        return f'    {one.name}: {wire} = Field("{default}", description={one.metadata["text"]!r})'
    return f"    {one.name}: {wire} = Field({default!r}, description={one.metadata['text']!r})"


def _type(kind: type[Effect], one: Field[Any]) -> str:
    if "choices" in one.metadata:
        return f"Literal[{', '.join(map(repr, one.metadata['choices']))}]"
    number = _number(kind, one)
    return " | ".join(_part(part.strip(), number) for part in str(one.type).split("|"))


def _part(part: str, number: str) -> str:
    nested = {"tuple[tuple[float, ...], ...]": f"list[list[{number}]]", "None": "None"}
    return nested.get(part, f"list[{number}]" if part.startswith("tuple") else number)


def _number(kind: type[Effect], one: Field[Any]) -> str:
    """A joint is counted from 1; other numbers have the unit of the option's name and the limits it says."""
    if one.name in kind.counted:
        return "JointNumber"
    plain = "int" if "int" in str(one.type) else "float"
    limits = {LIMITS[name]: value for name, value in one.metadata.items() if name in LIMITS}
    said = ", ".join(f"{name}={value!r}" for name, value in limits.items())
    symbol = next((symbol for ending, symbol in UNITS.items() if one.name.endswith(ending)), None)
    if symbol is not None:
        return f'Annotated[{plain}, unit("{symbol}"{", " + said if said else ""})]'
    return f"Annotated[{plain}, Field({said})]" if said else plain


def _lines() -> Iterator[str]:
    names, models = ", ".join(f'"{name}"' for name in EFFECTS), [f"{kind.__name__}Effect" for kind in EFFECTS.values()]
    yield "# fmt: off"
    yield from ("EffectName = Literal[", *_packed(names), "]")
    yield from (
        "EffectDocument = Annotated[",
        *_packed(" | ".join(models) + ","),
        '    Field(discriminator="id"),',
        "]",
    )
    yield "# fmt: on\n\n"
    yield "def _form(given: object) -> str:"
    yield '    """Whether an effect is told by its id alone or as an object."""'
    yield '    return "id" if isinstance(given, str) else "effect"\n\n'
    yield "# An effect by its id alone, with all it can act on, or as an object with its options."
    yield "AnyEffect = Annotated["
    yield '    Annotated[EffectName, Tag("id")] | Annotated[EffectDocument, Tag("effect")], Discriminator(_form)'
    yield "]"


def _packed(text: str) -> list[str]:
    return textwrap.wrap(text, 116, initial_indent="    ", subsequent_indent="    ", break_long_words=False)
