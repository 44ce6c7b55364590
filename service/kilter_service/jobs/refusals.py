"""One sentence for an option that a kind of job does not have or cannot take: the place, the kind, and the choices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from typing import Any, TypeVar

from pydantic import ValidationError

from kilter_core.errors import CoreError, OptionError
from kilter_service.contract.units import Asked
from kilter_service.contract.wording import describe_schema
from kilter_service.jobs.registry import KINDS, get_job_kind

OptionsT = TypeVar("OptionsT", bound=Asked)
Problem = Mapping[str, Any]

EFFECT_TAGS = ("id", "effect")  # of the two ways to name an effect, in the location of an error
MOST_SHOWN = 60


def read_options(kind: str, document: Mapping[str, Any]) -> Asked:
    """Read the options of a job.

    Raises:
        OptionError: one that does not exist or is invalid.

    """
    try:
        options: type[Asked] = get_job_kind(kind).contract.options
        return options.model_validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise _option_error(kind, first, document, tuple(first["loc"])) from error


def refusal(errors: Sequence[Problem], body: object) -> CoreError | None:
    """Return what is wrong with a job's kind or options; None when it is something else of the request."""
    kind = body.get("kind") if isinstance(body, dict) else None
    if not isinstance(kind, str):
        return None
    try:
        get_job_kind(kind)
    except CoreError as error:
        return error
    for problem in errors:
        place = tuple(part for part in problem["loc"] if part not in ("body", kind))
        if place[:1] == ("options",) and isinstance(body, dict):
            return _option_error(kind, problem, body.get("options"), place[1:])
    return None


def without_kind(errors: Sequence[Problem], body: object) -> list[dict[str, Any]]:
    """Return the errors of a request with places as they are in the body, which knows no kinds of body."""
    kind = body.get("kind") if isinstance(body, dict) else None
    return [
        {**one, "loc": tuple(part for k, part in enumerate(one["loc"]) if k != 1 or part != kind)} for one in errors
    ]


def _option_error(kind: str, problem: Problem, options: object, loc: tuple[Any, ...]) -> OptionError:
    if not loc:
        return OptionError(f"options of {kind}: {_describe_options_problem(kind, problem, options)}", option="options")
    where = ".".join(str(part) for part in ("options", *_in_body(loc, options)))
    return OptionError(f"{where}{_complaint(kind, problem, loc, options)}", option=str(loc[0]))


def _describe_options_problem(kind: str, problem: Problem, options: object) -> str:
    if problem["type"] == "missing":
        return f"{', '.join(_required_option_names(kind))} is missing. There are: {', '.join(_names(kind))}."
    return f"they are {_short_repr(options)}. Give an object with {', '.join(_names(kind))}."


def _complaint(kind: str, problem: Problem, loc: tuple[Any, ...], options: object) -> str:
    """What follows the place."""
    value, sort = problem.get("input"), problem["type"]
    if sort == "extra_forbidden":
        return f": {_unknown(kind, loc)}"
    schema = _option_schema(kind, loc)
    if sort == "missing":
        remedy = f"Give {describe_schema(schema)}." if schema else _option_description(kind, loc)
        return f" is missing: {kind} needs it. {remedy}"
    if loc[0] == "effects" and len(loc) > 1 and (sort.startswith("union_tag") or sort == "literal_error"):
        return _unknown_effect(kind, value, problem)
    if sort == "value_error":
        return f" is {_short_repr(value)}: {problem['ctx']['error']}, for a job of kind {kind}."
    words = f"give {describe_schema(schema)}" if schema else f"{problem['msg'][0].lower()}{problem['msg'][1:]}"
    return f" is {_short_repr(value)}: {words}, for a job of kind {kind}."


def _unknown(kind: str, loc: tuple[Any, ...]) -> str:
    """An option that does not exist, and who has it."""
    name = str(loc[-1])
    if loc[0] == "effects" and len(loc) > 2:
        owner = str(loc[-2])
        return f"{owner} has no option {name!r}. It has: {', '.join(_fields_of_effect(owner))}."
    if len(loc) > 1:
        return f"{loc[0]} of {kind} has no {name!r}. It has: {', '.join(_fields_inside(kind, str(loc[0])))}."
    others = [other for other in KINDS if name in _names(other)]
    near = get_close_matches(name, _names(kind), n=1)
    elsewhere = f" ({', '.join(others)} {'has' if len(others) == 1 else 'have'} it)" if others else ""
    hint = f" Do you mean {near[0]!r}?" if near else ""
    return f"{kind} has no option {name!r}{elsewhere}.{hint} It has: {', '.join(_names(kind))}."


def _unknown_effect(kind: str, value: object, problem: Problem) -> str:
    given = value.get("id") if isinstance(value, dict) else value
    known = ", ".join(_effects())
    if problem["type"] == "union_tag_not_found" or not isinstance(given, str):
        return f" is {_short_repr(value)}: give an id, or an object with its id, for a job of kind {kind}. There are: {known}."
    return f": there is no effect {given!r}. There are: {known}."


def _in_body(loc: Sequence[Any], options: object) -> list[Any]:
    """A place without the tags of unions, which the body does not have."""
    out: list[Any] = []
    node: Any = options
    for k, part in enumerate(loc):
        inside = part in node if isinstance(node, dict) else isinstance(node, list) and isinstance(part, int)
        if inside or k == len(loc) - 1:
            if not inside and (isinstance(node, list) or part in EFFECT_TAGS):
                continue  # a tag at the end
            out.append(part)
            node = node[part] if inside and (isinstance(node, dict) or part < len(node)) else None
    return out


def _names(kind: str) -> list[str]:
    return sorted(get_job_kind(kind).contract.options.model_fields)


def _required_option_names(kind: str) -> list[str]:
    return [name for name, field in get_job_kind(kind).contract.options.model_fields.items() if field.is_required()]


@cache
def _schema(kind: str) -> dict[str, Any]:
    options: type[Asked] = get_job_kind(kind).contract.options
    return options.model_json_schema()


@cache
def _effects() -> tuple[str, ...]:
    return tuple(_schema("identify")["$defs"] and _effect_models())


def _effect_models() -> dict[str, dict[str, Any]]:
    models = _schema("identify")["$defs"].values()
    return {
        model["properties"]["id"]["const"]: model for model in models if "const" in model["properties"].get("id", {})
    }


def _fields_of_effect(owner: str) -> list[str]:
    found = _effect_models().get(owner, {"properties": {}})
    return [name for name in found["properties"] if name != "id"]


def _fields_inside(kind: str, option: str) -> list[str]:
    """The fields of an option that is an object, or a list of them."""
    found = _schema(kind)["properties"][option]
    for part in (found, *found.get("anyOf", ()), found.get("items", {})):
        if "$ref" in part:
            return list(_schema(kind)["$defs"][part["$ref"].rpartition("/")[2]]["properties"])
    return []


def _option_description(kind: str, loc: tuple[Any, ...]) -> str:
    return str(_schema(kind)["properties"].get(loc[0], {}).get("description", ""))


def _option_schema(kind: str, loc: tuple[Any, ...]) -> dict[str, Any] | None:
    """The schema of an option; None deeper inside, where pydantic's own words are kept."""
    found: dict[str, Any] | None = _schema(kind)["properties"].get(loc[0]) if len(loc) == 1 else None
    return found


def _short_repr(value: object) -> str:
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."
