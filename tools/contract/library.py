"""The reference of the Python library, from its docstrings and its types."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import fields
from importlib import import_module
from typing import Any

import kilter
from kilter_client.results import corrected, record, rows, shown_jobs
from kilter_client.typed.names import JOBS, MODULE_OF

MADE = "<!-- Made from the docstrings by `make contract`: change it there. -->\n"
GROUPS = {
    "Robots": (
        "add_robot",
        "check_robot",
        "convert_robot",
        "find_robot",
        "find_frame",
        "robot",
        "robots",
        "set_controller_compensation",
        "set_tolerance",
        "today",
        "bridges",
        "drift_history",
        "drift_list",
        "add_repair",
        "remove_repair",
        "accept",
        "meshes",
        "set_mesh",
        "set_urdf_meshes",
        "remove_mesh",
    ),
    "Measurements": ("add_instrument", "instruments", "upload", "dry_run", "campaign", "campaigns", "suspicious"),
    "Jobs": (
        "identify",
        "gap",
        "evaluate",
        "plan",
        "joint_parameters",
        "drift",
        "rezero",
        "check",
        "submit",
        "job",
        "jobs",
        "wait",
        "cancel",
    ),
    "Fleets": ("identify_fleet", "fleet_jobs", "fleet_job", "wait_for_fleet", "cancel_fleet"),
    "Versions": (
        "version",
        "versions",
        "activate",
        "rollback",
        "activations",
        "preview",
        "diff",
        "residuals",
        "export",
    ),
    "Correction": ("correct", "torques", "filter"),
    "Keeping": ("change", "retire", "restore", "purge", "tombstones"),
    "Server": ("resolve", "health"),
    "Access": ("whoami", "login_link", "add_token", "tokens", "revoke_token", "audit", "verify_audit"),
}
# What results can do, by hand-written class.
BEHAVIOUR = {
    "Every result": (record.Record,),
    "Lists of results": (record.Records, rows.Tabular),
    "Parameters": (shown_jobs.ShownParameter,),
    "Identifications, versions and gap searches": (shown_jobs.Shown, shown_jobs.Asking),
    "Versions": (shown_jobs.OfVersion,),
    "Plans": (shown_jobs.ShownPlan,),
    "Dry runs": (corrected.DryRun,),
    "Figures": (shown_jobs.ShownFigure,),
    "Rows": (rows.Rows,),
    "Corrected trajectories": (corrected.Corrected,),
    "Corrected programs": (corrected.FilteredProgram,),
}
SECTION = re.compile(r"^(Args|Raises):\n", re.MULTILINE)
# What the signatures mean by these.
GIVEN = {
    "ResourceReference": "a robot, campaign, version or job: its name, its id or the beginning of it, `latest`, or the "
    "result that made it. Names and `latest` of campaigns, versions and jobs need `robot=` where no robot is named.",
    "Data": "rows: a path, columns by name, a structured array, a pandas DataFrame, or an array of two dimensions with "
    "`columns=`. Names are the [columns of a measurement](columns.md), with their unit.",
    "HeldOut": 'a share of the poses (`0.3`), a campaign or several, `{"folds": 5}`, or None: nothing is held out.',
    "Watching": "True: a progress bar on a terminal or in a notebook; False: none; or a function of the fraction done "
    "and the stage.",
    "Records": "a list of results, also by name, and a table.",
}
WIDEST = 100


def library_page() -> str:
    """Return the page of verbs."""
    lines = ["# The Python library\n", MADE, f"{_words(kilter.__doc__ or '')}\n"]
    lines.append(
        "A [lab script](../how-to/lab-script.md) shows it at work; the fields of every result are in its "
        "[types](library-types.md), exceptions in [errors](errors.md).\n"
    )
    lines.append(
        "Public are the names of `kilter` (`kilter_client` has the same) and of `kilter_client.stream`; modules below them "
        "may move.\n"
    )
    lines += [f"- `{name}`: {words}" for name, words in GIVEN.items()]
    lines.append("")
    lines.append(
        "`**options` are the [options of the job](job-options.md) by name. `timeout_s` ends the waiting after so many "
        "seconds, not the job.\n"
    )
    lines.append("## Connecting\n")
    for function in (kilter.connect, kilter.connect_async):
        lines += _function(function, f"kilter.{function.__name__}")
    lines.append("## Files\n")
    for reads in (kilter.inspect, kilter.draft, kilter.prepare):
        lines += _function(reads, f"kilter.{reads.__name__}")
    for title, names in GROUPS.items():
        lines.append(f"## {title}\n")
        made = [kind for kind in JOBS if title == "Jobs" and kind not in names]
        for name in (*names, *made):
            lines += _function(getattr(kilter.AsyncKilter, name), f"k.{name}", bound=True)
    lines.append("## Results\n")
    for title, kinds in BEHAVIOUR.items():
        lines.append(f"### {title}\n")
        for kind in kinds:
            lines += _kind(kind)
    return "\n".join(lines).rstrip() + "\n"


def types_page() -> str:
    """Return the page of the results' fields."""
    lines = ["# Types of the Python library\n", MADE]
    lines.append(
        "What answers hold, by type: `kilter.IdentifyResult` and so on. Units are in the names, or in the field `unit` "
        "beside a value. Lists are empty and values None where an answer has none; `result.document` is the answer as "
        "it came, also with what this release of the library does not know.\n"
    )
    for module in dict.fromkeys(MODULE_OF[name] for name in sorted(MODULE_OF)):
        lines.append(f"## {module.replace('_', ' ').capitalize()}\n")
        found = import_module(f"kilter_client.typed.{module}")
        for name in sorted(name for name, where in MODULE_OF.items() if where == module):
            lines += _type(getattr(found, name))
    return "\n".join(lines).rstrip() + "\n"


def _function(function: Callable[..., Any], called: str, bound: bool = False) -> Iterator[str]:
    signature = inspect.signature(function)
    own = [one for one in signature.parameters.values() if not (bound and one.name == "self")]
    yield f"### {called}\n"
    yield f"```python\n{_call(called, signature.replace(parameters=own))}\n```\n"
    yield f"{_described(function)}\n"


def _call(called: str, signature: inspect.Signature) -> str:
    """The signature as it would stand in a file, one argument a line where it is long."""
    given = [_argument(one) for one in signature.parameters.values()]
    kinds = [one.kind for one in signature.parameters.values()]
    if inspect.Parameter.KEYWORD_ONLY in kinds:
        given.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
    line = f"{called}({', '.join(given)}) -> {_short(signature.return_annotation)}"
    if len(line) <= WIDEST:
        return line
    body = "".join(f"    {one},\n" for one in given)
    return f"{called}(\n{body}) -> {_short(signature.return_annotation)}"


def _short(annotation: str) -> str:
    """An annotation as people read it: the types of answers are known without the module that each is in."""
    return re.sub(r"\btyped\.\w+\.", "", annotation)


def _argument(one: inspect.Parameter) -> str:
    stars = "**" if one.kind is inspect.Parameter.VAR_KEYWORD else ""
    default = "" if one.default is inspect.Parameter.empty else f" = {one.default!r}"
    return f"{stars}{one.name}: {_short(one.annotation)}{default}"


def _described(thing: Any) -> str:
    """A docstring as a page has it: its sections as lists."""
    head, *sections = SECTION.split(inspect.getdoc(thing) or "")
    text = _words(head.strip())
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        items = re.split(r"\n(?=\S)", inspect.cleandoc("\n" + body))
        lines = [f"- {_item(' '.join(item.split()))}" for item in items if item.strip()]
        text += f"\n\n{'Arguments' if title == 'Args' else 'Raises'}:\n\n" + "\n".join(lines)
    return text


def _item(text: str) -> str:
    return re.sub(r"(?:(?<=^)|(?<=; ))(\w+(?:, \w+)*): ", r"`\1`: ", _words(text))


def _kind(kind: type) -> Iterator[str]:
    yield f"{_described(kind)}\n"
    for name, value in vars(kind).items():
        if (
            name.startswith("_")
            or name in ("bound",)
            or not (callable(value) or isinstance(value, property | classmethod))
        ):
            continue
        if name == "read":
            continue
        words = _described(value.fget if isinstance(value, property) else value).partition("\n\nRaises:")
        raised = "".join(re.sub(r"\n+- ", " ", words[2])).strip()
        first = " ".join(words[0].split())
        yield f"- `{name}{'' if isinstance(value, property) else '()'}`: {first}{f' Raises {raised}' if raised else ''}"
    yield ""


def _type(kind: type) -> Iterator[str]:
    yield f"### {kind.__name__}\n"
    yield f"{_words(inspect.getdoc(kind) or '')}\n"
    bases = [base for base in kind.__mro__ if base.__module__.startswith("kilter_client.typed.")]
    source = "".join(inspect.getsource(base) for base in bases)
    described = dict(re.findall(r'^    (\w+): [^\n]+\n    """(.*?)"""$', source, re.M | re.S))
    own = sorted((one for one in fields(kind) if one.name != "document"), key=lambda one: one.name)
    if own:
        yield "| field | type | meaning |\n|---|---|---|"
        for one in own:
            yield f"| `{one.name}` | {_cell(f'`{one.type}`')} | {_cell(described.get(one.name, ''))} |"
    yield ""


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _words(text: str) -> str:
    return text.replace("``", "`")


if __name__ == "__main__":
    print(json.dumps({"library.md": library_page(), "library-types.md": types_page()}))
