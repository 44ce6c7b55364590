"""The Python client's types, from the snapshot of the HTTP interface: a type for each schema of an answer."""

from __future__ import annotations

import ast
import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

Schema = Mapping[str, Any]

RESULTS = Path(__file__).resolve().parents[2] / "clients/python/src/kilter_client/results"

# Which module holds what: the answers named here with all they need that no module before holds.
MODULES: Mapping[str, Sequence[str]] = {
    "robots": ("RobotReport", "RobotSummary", "RobotCheck", "FoundRobot", "Frame", "Mesh"),
    "budgets": ("Budget",),
    "kinematics": ("Flanges", "Postures"),
    "fits": ("Metrics", "Parameter", "NullDirection", "Objection", "Remark", "Figure", "Reference", "LoadNumber"),
    "acceptance": ("Acceptance",),
    "campaigns": ("Campaign", "Uploaded", "Instrument"),
    "cameras": ("CameraFound", "BoardFound", "PixelsFound"),
    "fleet_priors": ("PriorUsed",),
    "claims": ("NamedEffect", "Found", "MotionFound", "Untestable"),
    "identifications": ("IdentifyResult", "JointParametersResult"),
    "comparisons": ("Comparison", "VersionDiff", "Tombstone"),
    "previews": ("VersionPreview",),
    "versions": ("Version", "VersionSummary", "ActivatedVersion", "Activation"),
    "search_numbers": (
        "Adequacy",
        "AliasMatrix",
        "GapNoise",
        "GapSize",
        "NegativeControl",
        "Evidence",
        "Gates",
        "Amplitude",
    ),
    "effect_curves": ("EffectCurve",),
    "searches": ("GapResult",),
    "evaluations": ("EvaluateResult",),
    "plans": ("PlanResult",),
    "drifts": ("DriftResult", "RezeroResult", "DriftHistory", "DriftList", "Repair"),
    "server": ("Health", "ResolvedReference", "JobSummary", "Today", "BridgeList"),
}
JOB = "/v1/jobs/{job}"
# Types that share most fields: what all of them have is written once, in a type that they inherit.
FAMILIES: Mapping[str, tuple[str, str]] = {
    "AnyJob": (r"(?!Fleet)\w+Job", "What every job has."),
    "AnyCheck": (r"(?!Robot)\w+Check", "What the check of every kind of job says."),
    "AnyFit": ("IdentifyResult|Details", "What a fit says of itself, as a result and within its version."),
    "AnyFound": ("BoardFound|CameraFound", "What a fit found of a camera or of a board."),
}
INHERITED = 6  # fields that a type has of another one: with so many it inherits them
# What is written by hand for a type: how it is shown, and what can be made of it.
SHOWN: Mapping[str, str] = {
    "ActivatedVersion": "ShownActivated",
    "Campaign": "ShownCampaign",
    "DriftResult": "ShownDrift",
    "EvaluateResult": "ShownEvaluation",
    "Figure": "ShownFigure",
    "GapResult": "ShownSearch",
    "IdentifyResult": "ShownFit",
    "JointParametersResult": "ShownFit",
    "Metrics": "ShownMetrics",
    "Parameter": "ShownParameter",
    "PlanResult": "ShownPlan",
    "RezeroResult": "ShownDrift",
    "Uploaded": "ShownUpload",
    "Version": "ShownVersion",
    "VersionDiff": "ShownDiff",
    "VersionSummary": "OfVersion",
}
# Names that Python or the record they stand in has already.
RENAMED = {"class": "class_", "document": "posted"}
PLAIN = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}
REFERENCE = "#/components/schemas/"
INDENT = " " * 12
HEAD = '"""{}, made from the interface by `make contract`: change it there."""\n\nfrom __future__ import annotations\n'


def client_modules(interface: Schema) -> dict[str, str]:
    """Return the text of each module of ``kilter_client.typed``."""
    schemas = interface["components"]["schemas"]
    jobs = kinds_of_job(interface)
    checks = [name for job in jobs.values() if (name := f"{job.removesuffix('Job')}Check") in schemas]
    modules = {**MODULES, "checks": checks, "jobs": [*jobs.values()], "others": _answers(interface)}
    every = _needed(schemas, [root for roots in modules.values() for root in roots], {}, {})
    families = _families(schemas, every)
    schemas = {**schemas, **families}
    bases = _bases(schemas, [*families, *every])
    held: dict[str, str] = {}
    texts = {}
    for module, roots in modules.items():
        own = _needed(schemas, roots, held, bases)
        held |= dict.fromkeys(own, module)
        if own:
            texts[module] = _module(module, schemas, own, held, bases)
    texts["options"] = _options(schemas, [f"{name.removesuffix('Job')}Options" for name in jobs.values()])
    texts["names"] = _names({name: module for name, module in held.items() if name not in families}, jobs)
    return texts


def _families(schemas: Schema, every: Sequence[str]) -> dict[str, Schema]:
    """Schema of what all types of each family have."""
    found: dict[str, Schema] = {}
    for base, (names, text) in FAMILIES.items():
        family = [name for name in every if re.fullmatch(names, name)]
        if len(family) > 1:
            first, *others = map(_said, (schemas[name] for name in family))
            same = {field for field, one in first.items() if all(other.get(field) == one for other in others)}
            properties = {field: one for field, one in schemas[family[0]]["properties"].items() if field in same}
            found[base] = {"description": text, "properties": properties}
    return found


def _bases(schemas: Schema, every: Sequence[str]) -> dict[str, str]:
    """For each type the one whose fields it has all, if that is of some length: the longest."""
    said = {name: _said(schemas[name]).items() for name in every}
    # What all of a family have comes last among the equally long: a type may have no more than that.
    long = sorted(
        (name for name in every if name in FAMILIES or len(said[name]) >= INHERITED),
        key=lambda one: (len(said[one]), one in FAMILIES),
    )
    return {
        name: base
        for name in every
        for base in long
        if said[base] < said[name] or (base in FAMILIES and name not in FAMILIES and said[base] == said[name])
    }


def _said(schema: Schema) -> dict[str, tuple[str, str]]:
    """Type and text of each field."""
    return {field: (_type(one), _text(_described(one))) for field, one in schema.get("properties", {}).items()}


def kinds_of_job(interface: Schema) -> dict[str, str]:
    """Return the schema of the job of each kind."""
    answer = interface["paths"][JOB]["get"]["responses"]["200"]["content"]["application/json"]["schema"]
    found = answer["discriminator"]["mapping"]
    return {kind: name.removeprefix(REFERENCE) for kind, name in sorted(found.items())}


def _answers(interface: Schema) -> list[str]:
    """Schemas that routes answer with; lists are read item by item, and robots stay documents."""
    answers = [
        answer for path in interface["paths"].values() for one in path.values() for answer in one["responses"].items()
    ]
    text = json.dumps([answer for status, answer in answers if status.startswith("2")])
    found = sorted(set(re.findall(rf'"{REFERENCE}(\w+)"', text)))
    return [name for name in found if not name.endswith(("List", "Robot"))]


def _needed(schemas: Schema, roots: Sequence[str], held: Mapping[str, str], bases: Mapping[str, str]) -> list[str]:
    """Schemas that a module holds, what is needed before what needs it."""
    own: list[str] = []

    def visit(name: str) -> None:
        if name in held or name in own:
            return
        for needed in sorted(_needs(schemas, name, bases)):
            visit(needed)
        own.append(name)

    for root in roots:
        visit(root)
    return own


def _needs(schemas: Schema, name: str, bases: Mapping[str, str]) -> set[str]:
    """The types that stand in the text of a type."""
    return _named(_own(schemas, name, bases)) | ({bases[name]} if name in bases else set())


def _own(schemas: Schema, name: str, bases: Mapping[str, str]) -> dict[str, str]:
    """Types of the fields that are not inherited.

    What is written by hand for a type stands before what it inherits, and says less of the fields that it needs.
    """
    inherited = set(schemas[bases[name]]["properties"] if name in bases else ()) - _needed_by_hand(name)
    return {field: _type(one) for field, one in schemas[name].get("properties", {}).items() if field not in inherited}


def _needed_by_hand(name: str) -> set[str]:
    """Fields that what is written by hand for a type states."""
    if name not in SHOWN:
        return set()
    return _stated_fields(SHOWN[name])


def _stated_fields(name: str) -> set[str]:
    """Fields that a class written by hand states, itself or by what it derives from."""
    kind = _classes_by_hand().get(name)
    if kind is None:
        return set()
    own = {one.target.id for one in kind.body if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)}
    return own.union(*(_stated_fields(base.id) for base in kind.bases if isinstance(base, ast.Name)))


@cache
def _classes_by_hand() -> dict[str, ast.ClassDef]:
    """Classes of ``kilter_client.results``, read and not imported: what they need may not be installed."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted(RESULTS.glob("*.py"))]
    return {one.name: one for tree in trees for one in tree.body if isinstance(one, ast.ClassDef)}


def _named(types: Mapping[str, str]) -> set[str]:
    """Types of ours that stand in the hints; words in quotes are values."""
    words = " ".join(re.sub(r'"[^"]*"', "", text) for text in types.values())
    return set(re.findall(r"\b[A-Z]\w+\b", words)) - {"Any", "Literal", "Mapping", "None", "Records", "Sequence"}


def _type(schema: Schema) -> str:
    """Type of a field. Lists and objects are empty instead of null; robots and options stay documents.

    Every figure is one type to the library: a document of Plotly that can be drawn and saved, under its name.
    """
    variants = schema.get("anyOf")
    if variants:
        kinds = list(dict.fromkeys(_type(one) for one in variants))
        holds = [kind for kind in kinds if kind != "None"]
        return (
            holds[0] if len(holds) == 1 and holds[0].startswith(("Records", "tuple", "Mapping")) else " | ".join(kinds)
        )
    if "$ref" in schema:
        name = schema["$ref"].removeprefix(REFERENCE)
        if name.endswith("Figures"):
            return "Mapping[str, Figure]"
        return "Mapping[str, Any]" if name.endswith("Options") or name == "Folds" else str(name)
    if "const" in schema or "enum" in schema:
        return "str" if schema.get("type") == "string" else PLAIN[schema["type"]]
    if schema.get("type") == "array":
        return _array(schema)
    if schema.get("type") == "object" or "oneOf" in schema:
        inner = schema.get("additionalProperties")
        return f"Mapping[str, {_type(inner) if isinstance(inner, Mapping) and inner else 'Any'}]"
    return PLAIN[schema["type"]]


def _array(schema: Schema) -> str:
    items = schema.get("items") or (schema.get("prefixItems") or [{}])[0]
    inner = _type(items) if items else "Any"
    return f"Records[{inner}]" if "$ref" in items else f"tuple[{inner}, ...]"


def _module(module: str, schemas: Schema, own: Sequence[str], held: Mapping[str, str], bases: Mapping[str, str]) -> str:
    classes = "\n".join(line for name in own for line in _class(name, schemas, bases))
    lines = [HEAD.format(f"What the server answers about {module.replace('_', ' ')}")]
    if re.search(r"\bMapping\[", classes):
        lines.append("from collections.abc import Mapping")
    typing = [name for name in ("Any", "ClassVar") if re.search(rf"\b{name}\b", classes)]
    if typing:
        lines.append(f"from typing import {', '.join(typing)}")
    if len(lines) > 1:
        lines.append("")
    records = [name for name, used in (("Record", "Record):"), ("Records", "Records[")) if used in classes]
    if records:
        lines.append(f"from kilter_client.results.record import {', '.join(records)}")
    shown = sorted({SHOWN[name] for name in own if name in SHOWN})
    if shown:
        lines.append(f"from kilter_client.results.shown_jobs import {', '.join(shown)}")
    used: dict[str, set[str]] = {}
    for name in own:
        for needed in _needs(schemas, name, bases) - set(own):
            used.setdefault(held[needed], set()).add(needed)
    lines += [f"from kilter_client.typed.{other} import {', '.join(sorted(used[other]))}" for other in sorted(used)]
    return "\n".join(lines) + "\n\n" + classes


def _class(name: str, schemas: Schema, bases: Mapping[str, str]) -> Iterator[str]:
    base = bases.get(name, "Record")
    yield f"\nclass {name}({SHOWN[name]}, {base}):" if name in SHOWN else f"\nclass {name}({base}):"
    yield f'    """{_text(schemas[name]["description"])}"""'
    own, properties = _own(schemas, name, bases), schemas[name]["properties"]
    if own:
        yield ""
    if any(field in RENAMED for field in own):
        renamed = {RENAMED[field]: field for field in properties if field in RENAMED}
        yield f"    RENAMED: ClassVar[Mapping[str, str]] = {renamed!r}"
    for field, kind in own.items():
        yield f"    {RENAMED.get(field, field)}: {kind}"
        yield f'    """{_text(_described(properties[field]))}"""'
    yield ""


def _described(schema: Schema) -> str:
    return str(schema.get("description", ""))


def _text(text: str) -> str:
    """Say None where the interface says null, as Python does; nothing at the end of a name in quotes is lost."""
    text = re.sub(r"\bnull\b", "None", text).replace("\\", "\\\\")
    return text + " " if text.endswith('"') else text


def _options(schemas: Schema, names: Sequence[str]) -> str:
    lines = [HEAD.format("Options of jobs by name")]
    lines += ["from collections.abc import Mapping, Sequence", "from typing import Any, Literal, TypedDict\n"]
    for name in names:
        lines.append(f"\nclass {name}(TypedDict, total=False):")
        lines.append(f'    """{_text(schemas[name]["description"])}"""\n')
        for field, one in schemas[name]["properties"].items():
            lines.append(f"    {field}: {_given(one)}")
            lines.append(f'    """{_text(_described(one))}"""')
        lines.append("")
    return "\n".join(lines)


def _given(schema: Schema) -> str:
    """Type of an option as it is given: any sequence, and values by name."""
    variants = schema.get("anyOf")
    if variants:
        return " | ".join(dict.fromkeys(_given(one) for one in variants))
    if "oneOf" in schema:
        return "str | Mapping[str, Any]"
    if "$ref" in schema:
        return "Mapping[str, Any]"
    if "enum" in schema or "const" in schema:
        values = schema.get("enum") or [schema["const"]]
        return f"Literal[{', '.join(map(json.dumps, values))}]"
    if schema.get("type") == "array":
        items = schema.get("items") or (schema.get("prefixItems") or [{}])[0]
        return f"Sequence[{_given(items) if items else 'Any'}]"
    return "Mapping[str, Any]" if schema.get("type") == "object" else PLAIN[schema["type"]]


def _names(held: Mapping[str, str], jobs: Mapping[str, str]) -> str:
    lines = [
        HEAD.format("In which module each type is"),
        "MODULE_OF = {",
        "    name: module",
        "    for module, names in {",
    ]
    for module in dict.fromkeys(held.values()):
        names = " ".join(sorted(name for name, where in held.items() if where == module))
        lines += [
            f'        {module!r}: """',
            textwrap.fill(names, 116, initial_indent=INDENT, subsequent_indent=INDENT),
            f'{INDENT}""",',
        ]
    lines += ["    }.items()", "    for name in names.split()", "}"]
    lines += ["JOBS = {", *(f"    {kind!r}: {name!r}," for kind, name in jobs.items()), "}"]
    return "\n".join([*lines, ""])
