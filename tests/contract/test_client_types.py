"""The types of the Python client follow the interface, also where it changes its shape."""

from __future__ import annotations

from importlib import import_module
from inspect import get_annotations
from pathlib import Path
from typing import Any, get_type_hints

import pytest

from kilter_client.results.record import scalar_names
from kilter_client.typed.checks import AnyCheck, EvaluateCheck, GapCheck, RezeroCheck
from kilter_client.typed.fits import Metrics
from kilter_client.typed.jobs import PlanJob
from kilter_client.typed.names import MODULE_OF
from kilter_client.typed.versions import Version, VersionSummary
from tools.contract import client_types
from tools.contract.client_types import client_modules

REPOSITORY = Path(__file__).resolve().parents[2]


def schema(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "description": "What it is; null: nothing.", "properties": properties}


def of(name: str, **more: Any) -> dict[str, Any]:
    return {"$ref": f"#/components/schemas/{name}", **more}


def or_null(one: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [one, {"type": "null"}], "description": "Of it; null: none."}


def by_kind(name: str) -> dict[str, Any]:
    answer = {"discriminator": {"mapping": {"identify": f"#/components/schemas/{name}"}}}
    return {"responses": {"200": {"content": {"application/json": {"schema": answer}}}}}


@pytest.fixture
def interface(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    schemas = {
        "IdentifyJob": schema(
            id={"type": "string"}, result=or_null(of("IdentifyResult")), options=of("IdentifyOptions")
        ),
        "IdentifyOptions": schema(
            level=or_null({"enum": [1, 2], "type": "integer"}),
            free={"type": "array", "items": {"type": "string"}},
        ),
        "IdentifyResult": schema(
            figures=or_null(of("IdentifyFigures")),
            parts=or_null({"type": "array", "items": of("Part")}),
            q_deg=or_null({"type": "array", "items": {"type": "number"}}),
            noise_mm=or_null({"type": "number", "x-unit": "mm"}),
            by_name={"type": "object", "additionalProperties": of("Part")},
        ),
        "IdentifyFigures": schema(errors=or_null(of("Figure"))),
        "Figure": schema(data={"type": "array", "items": {"oneOf": [of("Bars"), of("Lines")]}}),
        "Part": schema(**{"class": {"type": "string", "description": "Its class."}, "document": {"type": "object"}}),
    }
    paths = {"/v1/jobs/{job}": {"get": by_kind("IdentifyJob")}}
    monkeypatch.setattr(client_types, "MODULES", {"fits": ("Figure",)})
    return {"components": {"schemas": schemas}, "paths": paths}


def test_what_the_types_of_an_interface_are(interface: dict[str, Any]) -> None:
    made = client_modules(interface)
    jobs = made["jobs"]
    for line in (
        "figures: Mapping[str, Figure]",
        "parts: Records[Part]",
        "q_deg: tuple[float, ...]",
        "noise_mm: float | None",
        "by_name: Mapping[str, Part]",
        "class_: str",
        "posted: Mapping[str, Any]",
        "RENAMED: ClassVar[Mapping[str, str]] = {'class_': 'class', 'posted': 'document'}",
        "result: IdentifyResult | None",
        "options: Mapping[str, Any]",
        "from kilter_client.typed.fits import Figure",
        '"""What it is; None: nothing."""',
    ):
        assert f"{line}\n" in jobs, line
    assert "data: tuple[Mapping[str, Any], ...]\n" in made["fits"]
    assert "IdentifyFigures" not in "".join(made.values())
    assert "'identify': 'IdentifyJob'" in made["names"]
    assert "level: Literal[1, 2] | None\n" in made["options"]
    assert "free: Sequence[str]\n" in made["options"]


def test_what_all_jobs_have_is_written_once(interface: dict[str, Any]) -> None:
    schemas = interface["components"]["schemas"]
    schemas["PlanJob"] = schema(id={"type": "string"}, result={"type": "number"}, options=of("PlanOptions"))
    schemas["PlanOptions"] = schema()
    answer = interface["paths"]["/v1/jobs/{job}"]["get"]["responses"]["200"]["content"]["application/json"]["schema"]
    answer["discriminator"]["mapping"]["plan"] = "#/components/schemas/PlanJob"
    jobs = client_modules(interface)["jobs"]
    base, others = jobs.partition("class AnyJob(Record):")[2].split("class IdentifyJob(AnyJob):")
    assert "id: str\n" in base
    assert "result" not in base
    assert "id: str\n" not in others
    assert "class PlanJob(AnyJob):" in others
    assert others.count("result: ") == 2


def test_a_job_reads_what_it_inherits() -> None:
    job = PlanJob.read({"id": "job_1", "kind": "plan", "state": "queued", "attempts": 2})
    assert (job.id, job.kind, job.state, job.attempts, job.result) == ("job_1", "plan", "queued", 2, None)


def test_a_type_inherits_the_fields_that_it_has_of_another_one() -> None:
    short, long = VersionSummary.read({"id": "ver_1", "name": "a"}), Version.read({"id": "ver_1", "name": "a"})
    assert isinstance(long, VersionSummary)
    assert (long.id, long.version_id, long.name) == (short.id, short.version_id, short.name)
    assert list(long.document) == ["id", "name"]


def test_checks_of_all_kinds_of_job_inherit_what_all_have() -> None:
    """A check of a search was one of a re-zeroing to the library: any that has no more than all have can stand for them all."""
    check = EvaluateCheck.read({"kind": "evaluate", "would_run": True})
    assert isinstance(check, AnyCheck)
    assert (check.kind, check.would_run) == ("evaluate", True)
    assert not issubclass(GapCheck, RezeroCheck)


def test_no_field_is_of_another_type_because_what_is_written_by_hand_needs_it() -> None:
    """`metrics` of a version was a plain document: its table states that it needs some, before what it inherits."""
    assert isinstance(Version.read({"id": "ver_1", "metrics": {"train": {}}}).metrics, Metrics)
    for name, module in MODULE_OF.items():
        kind = getattr(import_module(f"kilter_client.typed.{module}"), name)
        for field in get_type_hints(kind):
            holders = [one for one in kind.__mro__ if field in get_annotations(one)]
            made = [one for one in holders if one.__module__.startswith("kilter_client.typed")]
            assert not made or made[0] is holders[0], (name, field)


def test_what_is_inherited_is_described_too() -> None:
    page = (REPOSITORY / "docs/reference/library-types.md").read_text(encoding="utf-8")
    table = page.partition("### PlanJob\n")[2].partition("###")[0]
    assert "| `robot` | `str` | Name of the robot. |" in table
    assert "|  |" not in page


def test_columns_of_records_are_by_the_alphabet_whatever_is_inherited() -> None:
    names = scalar_names(Version)
    assert names[:2] == ("id", "name")
    assert list(names[2:]) == sorted(names[2:])
