"""The HTTP interface is a promise: a change of it must be seen, in the snapshot beside this file."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from kilter_service.ground.errors import PROBLEMS
from tools.contract.interface import SNAPSHOT, interface_document, interface_text, with_sorted_required
from tools.contract.lists import served_interface

Change = Callable[[dict[str, Any]], object]
PROMISED = {
    "POST /v1/robots",
    "POST /v1/robots/{robot}/campaigns",
    "POST /v1/campaigns/{campaign}/observations",
    "POST /v1/jobs",
    "GET /v1/jobs/{job}",
    "GET /v1/jobs/{job}/events",
    "POST /v1/jobs/{job}/cancel",
    "GET /v1/robots/{robot}/versions",
    "GET /v1/versions/{version}",
    "POST /v1/versions/{version}/activate",
    "POST /v1/robots/{robot}/rollback",
    "GET /v1/versions/{version}/export",
    "GET /v1/versions/{a}/diff/{b}",
    "POST /v1/robots/{robot}/correct",
}


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return served_interface()


@pytest.fixture(scope="module")
def text(document: dict[str, Any]) -> str:
    return interface_text(document, PROBLEMS)


def test_the_interface_is_the_snapshot(text: str) -> None:
    """Run `make contract` to accept a change, and say it in the changelog."""
    assert text == SNAPSHOT.read_text(encoding="utf-8")


def test_the_snapshot_loses_nothing_of_the_interface(document: dict[str, Any], text: str) -> None:
    schemas = document["components"]["schemas"]
    expected = document | {
        "components": document["components"] | {"schemas": {n: with_sorted_required(s) for n, s in schemas.items()}}
    }
    assert interface_document(text) == expected
    assert len(text.splitlines()) < 4000
    assert ": json " not in text  # all of it has the form of a line


def model(document: dict[str, Any]) -> Any:
    return document["components"]["schemas"]["IdentifyOptions"]


def fields(document: dict[str, Any]) -> Any:
    return model(document)["properties"]


def options(document: dict[str, Any], name: str) -> Any:
    return fields(document)[name]


def listing(document: dict[str, Any]) -> Any:
    return document["paths"]["/v1/jobs"]["get"]


def submit(document: dict[str, Any]) -> Any:
    return document["paths"]["/v1/jobs"]["post"]


# A change of the document, and what the one line that is new or other must say.
CHANGES: dict[str, tuple[str, Change]] = {
    "type": ("tilt_first: integer", lambda d: options(d, "tilt_first").update(type="integer")),
    "no null": ("com_sigma_mm: (number(", lambda d: options(d, "com_sigma_mm")["anyOf"].pop()),
    "required": ("IdentifyOptions.base: required", lambda d: model(d).update(required=["base"])),
    "bound": ("exclusiveMinimum 0.5", lambda d: options(d, "search_mm").update(exclusiveMinimum=0.5)),
    "length": ("maxItems 9", lambda d: options(d, "free").update(maxItems=9)),
    "length of a word": ("maxLength 9", lambda d: options(d, "free")["items"].update(maxLength=9)),
    "pattern": ('pattern "^x"', lambda d: options(d, "free")["items"].update(pattern="^x")),
    "enum": ('"huber"])', lambda d: options(d, "loss")["enum"].pop()),
    "order of an enum": ('enum ["tukey"', lambda d: options(d, "loss")["enum"].reverse()),
    "constant": ('const "flock"', lambda d: options(d, "prior")["anyOf"][0].update(const="flock")),
    "default": ("= 2", lambda d: options(d, "seed").update(default=2)),
    "whole default": ("= 0.0", lambda d: options(d, "seed").update(default=0.0)),
    "no default": ("seed: integer(maximum 2147483648.0, minimum 0.0) --", lambda d: options(d, "seed").pop("default")),
    "description": (
        "-- Drawn\\nby \\\\chance.",
        lambda d: options(d, "seed").update(description="Drawn\nby \\chance."),
    ),
    "no description": (
        "seed: integer(maximum 2147483648.0, minimum 0.0) = 0",
        lambda d: options(d, "seed").pop("description"),
    ),
    "example": ('examples ["a | b"]', lambda d: options(d, "start").update(examples=["a | b"])),
    "title": ('title "Its seed"', lambda d: options(d, "seed").update(title="Its seed")),
    "no title": ("title null", lambda d: options(d, "seed").pop("title")),
    "unit": ('x-unit "um"', lambda d: options(d, "search_mm").update({"x-unit": "um"})),
    "model of a field": (
        "limits: Limits |",
        lambda d: options(d, "limits")["anyOf"][0].update({"$ref": "#/components/schemas/Limits"}),
    ),
    "schema that no line has": ("seed: any(allOf", lambda d: fields(d).update(seed={"allOf": [], "title": "Seed"})),
    "further fields": ("IdentifyOptions: object --", lambda d: model(d).pop("additionalProperties")),
    "new field": ("IdentifyOptions.new: string", lambda d: fields(d).update(new={"type": "string", "title": "New"})),
    "new model": (
        "Empty: object",
        lambda d: d["components"]["schemas"].update(Empty={"type": "object", "title": "Empty"}),
    ),
    "role": ('x-kilter-role "viewer"', lambda d: submit(d).update({"x-kilter-role": "viewer"})),
    "token": ("security []", lambda d: submit(d).update(security=[])),
    "parameter": ("query limit: required", lambda d: listing(d)["parameters"][1].update(required=True)),
    "place of a parameter": ("header limit:", lambda d: listing(d)["parameters"][1].update({"in": "header"})),
    "body": ("body text/csv", lambda d: submit(d)["requestBody"]["content"].update({"text/csv": {"schema": {}}})),
    "body may be left out": ("body application/json: <kind", lambda d: submit(d)["requestBody"].pop("required")),
    "kind of a body": ("| zero NewRezeroJob>", lambda d: rename_kind(d)),
    "answer": ("GET /v1/jobs 204:", lambda d: listing(d)["responses"].update({"204": {"description": "None"}})),
    "header of an answer": ('"headers"', lambda d: listing(d)["responses"]["200"].update(headers={"A": {}})),
    "code of an error": ("error toy: 418 Tea", lambda d: d.update(toy=True)),
}


def rename_kind(document: dict[str, Any]) -> None:
    mapping = submit(document)["requestBody"]["content"]["application/json"]["schema"]["discriminator"]["mapping"]
    mapping["zero"] = mapping.pop("rezero")


@pytest.mark.parametrize("change", CHANGES)
def test_every_change_of_the_interface_is_a_line_that_says_it(document: dict[str, Any], text: str, change: str) -> None:
    says, apply = CHANGES[change]
    changed = copy.deepcopy(document)
    apply(changed)
    codes = PROBLEMS | ({"toy": (418, "Tea")} if changed.pop("toy", False) else {})
    before = set(text.splitlines())
    (line,) = (one for one in interface_text(changed, codes).splitlines() if one not in before)
    assert says in line


def test_what_is_left_out_of_the_interface_is_a_line_less(document: dict[str, Any], text: str) -> None:
    changed = copy.deepcopy(document)
    del changed["components"]["schemas"]["IdentifyOptions"]["properties"]["seed"]
    del changed["paths"]["/v1/jobs"]["get"]["parameters"][1]
    del changed["paths"]["/v1/whoami"]["get"]
    before, after = text.splitlines(), interface_text(changed, PROBLEMS).splitlines()
    gone = [line for line in before if line not in after]
    assert not set(after) - set(before)
    assert [line.partition(":")[0] for line in gone if "whoami" not in line] == [
        "GET /v1/jobs query limit",
        "IdentifyOptions.seed",
    ]
    assert sum(line.startswith("GET /v1/whoami") for line in gone) >= 2


def test_what_the_contract_promises_is_there(document: dict[str, Any]) -> None:
    paths = document["paths"]
    there = {f"{method.upper()} {path}" for path, methods in paths.items() for method in methods}
    assert there >= PROMISED


def test_every_route_says_whether_it_needs_a_token_and_of_which_role(document: dict[str, Any]) -> None:
    (scheme,) = document["components"]["securitySchemes"].values()
    assert (scheme["type"], scheme["scheme"]) == ("http", "bearer")
    operations = {
        f"{m.upper()} {path}": one for path, methods in document["paths"].items() for m, one in methods.items()
    }
    assert all("security" in one for one in operations.values())
    assert not operations["GET /v1/health"]["security"]
    read, change = operations["GET /v1/robots"], operations["POST /v1/versions/{version}/activate"]
    assert (read["x-kilter-role"], read["security"]) == ("viewer", [{"token": []}, {}])
    assert (change["x-kilter-role"], change["security"]) == ("operator", [{"token": []}])
    assert operations["GET /v1/audit"]["security"] == [{"token": []}]


def test_every_route_says_that_errors_are_problem_documents(document: dict[str, Any]) -> None:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            for status in ("4XX", "422", "5XX"):
                (media,) = operation["responses"][status]["content"]
                assert media == "application/problem+json", (method, path, status)
                schema = operation["responses"][status]["content"][media]["schema"]
                assert schema["$ref"].endswith("/Problem"), (method, path)
            assert operation["summary"]
