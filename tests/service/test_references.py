"""Prefixes, names and `latest` for ids; names and notes; what is retired, restored and purged."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import CampaignRow, JobRow, VersionRow
from kilter_service.versions import store
from kilter_service.versions.predictions.unfitted_rows import Archive
from kilter_service.versions.store import NewVersion

ROBOT = {"name": "katana", "convention": "preset", "preset": "katana450-chapter5"}
OTHER = {**ROBOT, "name": "other"}


class Shelf:
    """Puts campaigns, versions and jobs with chosen ids into the database."""

    def __init__(self, client: httpx.Client, database: Database) -> None:
        self.client, self.database = client, database
        for document in (ROBOT, OTHER):
            client.post("/v1/robots", json=document).raise_for_status()
        self._calibration = thesis_katana().truth.to_document()

    def campaign(self, end: str, name: str, robot_id: int = 1, staged: bool = False) -> str:
        row = {"robot_id": robot_id, "device": "", "role": "train", "conditions": {}, "notes": "", "staged": staged}
        with self.database.transaction() as session:
            session.add(CampaignRow(id=f"cmp_{end}", name=name, **row))
        return f"cmp_{end}"

    def job(self, end: str, state: str = "succeeded", name: str = "", **request: Any) -> str:
        asked = {"kind": "identify", "robot": "katana", **request}
        with self.database.transaction() as session:
            session.add(JobRow(id=f"job_{end}", kind="identify", robot_id=1, request=asked, state=state, name=name))
        return f"job_{end}"

    def version(self, end: str, *campaigns: str, parent: str | None = None, name: str = "") -> str:
        used = [{"id": c, "name": "", "role": "train", "use": "train", "rows": 1, "sha256": []} for c in campaigns]
        limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
        report = {"parameters": [], "metrics": {}, "noise_mm": 0.01}
        new = NewVersion(
            self._calibration, report, {"names": [], "matrix": []}, used, limits, parent, "test", name
        )  # fmt: skip
        job = self.job(end)
        with self.database.transaction() as session:
            return store.add(session, 1, job, new)

    def resolve(self, kind: str, reference: str, robot: str | None = None) -> dict[str, Any]:
        asked = {"kind": kind, "reference": reference} | ({"robot": robot} if robot else {})
        found: dict[str, Any] = self.client.get("/v1/resolve", params=asked).json()
        return found


@pytest.fixture
def shelf(client: httpx.Client, database: Database) -> Shelf:
    return Shelf(client, database)


def refused(answer: httpx.Response, status: int, code: str, *words: str) -> dict[str, Any]:
    document: dict[str, Any] = answer.json()
    assert (answer.status_code, document["code"]) == (status, code), document
    for word in words:
        assert word in document["detail"], document["detail"]
    return document


def test_prefixes_names_and_latest_stand_for_one_id(shelf: Shelf) -> None:
    first = shelf.campaign("646e61e82fd541c1", "monday")
    second = shelf.campaign("641e61e82fd541c1", "tuesday, after the crash: Größe")
    staged = shelf.campaign("ffffffffffffffff", "not whole", staged=True)
    for reference, by in ((first, "id"), ("cmp_646", "prefix"), ("646e", "prefix"), ("monday", "name")):
        found = shelf.resolve("campaign", reference)
        assert found == {
            "kind": "campaign", "id": first, "robot": "katana", "name": "monday", "by": by, "number": 0,
        }  # fmt: skip
    assert shelf.resolve("campaign", "tuesday, after the crash: Größe")["id"] == second
    assert shelf.resolve("campaign", "latest", "katana")["id"] == second
    assert shelf.resolve("campaign", "latest")["id"] == second  # one robot has campaigns
    assert shelf.resolve("campaign", staged)["code"] == "campaign_not_found"
    version, job = shelf.version("0a"), "job_0a"
    assert shelf.resolve("version", "latest", "katana")["id"] == version
    assert shelf.resolve("job", "latest", "katana")["id"] == shelf.resolve("job", "job_0a")["id"] == job
    # A word of three letters that happens to be hexadecimal is no id: names are mistyped.
    assert shelf.resolve("campaign", "646")["code"] == "campaign_not_found"


def test_versions_are_counted_for_each_robot_and_named_by_number(shelf: Shelf) -> None:
    client, first, second = shelf.client, shelf.version("0a"), shelf.version("0b")
    listed = client.get("/v1/robots/katana/versions").json()["versions"]
    assert {one["id"]: one["number"] for one in listed} == {first: 1, second: 2}
    for reference, robot in (("katana v2", None), ("v2", "katana"), ("v2", None)):
        found = shelf.resolve("version", reference, robot)
        assert (found["id"], found["robot"], found["number"], found["by"]) == (second, "katana", 2, "number")
    assert shelf.resolve("version", second)["number"] == 2
    assert client.get("/v1/versions/katana v2").json()["id"] == second
    for reference in ("katana v3", "other v1", "katana v0", "katana v02"):
        assert shelf.resolve("version", reference)["code"] == "version_not_found"
        refused(client.get(f"/v1/versions/{reference}"), 404, "version_not_found")
    campaign = shelf.campaign("646e", "monday")
    asked = {"kind": "evaluate", "robot": "katana", "campaigns": [campaign], "options": {"version": "katana v2"}}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    with shelf.database.reading() as session:
        assert session.get_one(JobRow, job).request["options"]["version"] == second
    asked["robot"] = "other"
    assert client.post("/v1/jobs", json=asked).status_code == 400
    assert client.post("/v1/versions/katana v2/activate").json()["id"] == second


def test_a_number_is_never_given_twice(shelf: Shelf) -> None:
    shelf.version("0a")
    purged = shelf.version("0b")
    shelf.client.post(f"/v1/versions/{purged}/purge").raise_for_status()
    shelf.version("0c")
    listed = shelf.client.get("/v1/robots/katana/versions").json()["versions"]
    assert [one["number"] for one in listed] == [3, 1]
    assert shelf.resolve("version", "katana v2")["code"] == "version_not_found"


def test_a_name_that_reads_as_the_number_of_another_is_not_guessed(shelf: Shelf) -> None:
    first, second = shelf.version("0a"), shelf.version("0b", name="katana v1")
    asked = {"kind": "version", "reference": "katana v1"}
    refused(shelf.client.get("/v1/resolve", params=asked), 409, "reference_ambiguous", first, second, "give the id")
    renamed = shelf.client.patch(f"/v1/versions/{first}", json={"name": "v2"})
    refused(renamed, 400, "name_invalid", "'v2'", "is the number of one")
    assert shelf.client.patch(f"/v1/versions/{first}", json={"name": "wrist v2"}).status_code == 200


def test_an_ambiguous_reference_lists_the_candidates(shelf: Shelf) -> None:
    first, second = shelf.campaign("646e", "monday"), shelf.campaign("641e", "tuesday")
    found = shelf.client.get("/v1/resolve", params={"kind": "campaign", "reference": "cmp_64"})
    document = refused(found, 409, "reference_ambiguous", first, "'monday'", second, "'tuesday'", "type more of it")
    assert sorted(document["context"]["candidates"]) == sorted([first, second])
    other = shelf.campaign("7", "monday", robot_id=2)
    found = shelf.client.get("/v1/resolve", params={"kind": "campaign", "reference": "monday"})
    refused(found, 409, "reference_ambiguous", first, other, "'katana'", "'other'", "--robot")
    found = shelf.client.get("/v1/resolve", params={"kind": "campaign", "reference": "latest"})
    refused(found, 409, "reference_ambiguous", "name its robot (--robot)")
    assert shelf.resolve("campaign", "monday", "other")["id"] == other


def test_a_name_goes_before_a_prefix(shelf: Shelf) -> None:
    shelf.campaign("646e", "monday")
    named = shelf.campaign("99", "64")
    assert shelf.resolve("campaign", "64")["id"] == named


@pytest.mark.parametrize("reference", ["%", "_", "cmp_", "cmp_%", "", "CMP_64", "64%"])
def test_signs_of_the_query_language_stand_for_themselves(shelf: Shelf, reference: str) -> None:
    shelf.campaign("646e", "monday")
    assert shelf.resolve("campaign", reference)["code"] in ("campaign_not_found", "payload_invalid")


def test_what_is_not_there_is_said_with_what_is(shelf: Shelf) -> None:
    shelf.campaign("646e", "monday")
    asked = {"kind": "campaign", "reference": "mondey", "robot": "katana"}
    refused(shelf.client.get("/v1/resolve", params=asked), 404, "campaign_not_found", "Robot 'katana' has no campaign",
            "cmp_646e 'monday'")  # fmt: skip
    asked = {"kind": "version", "reference": "cmp_646e"}
    refused(shelf.client.get("/v1/resolve", params=asked), 404, "version_not_found", "an id of a campaign")
    asked = {"kind": "version", "reference": "latest", "robot": "katana"}
    refused(shelf.client.get("/v1/resolve", params=asked), 404, "version_not_found", "has no version.")
    asked = {"kind": "version", "reference": "latest", "robot": "nobody"}
    refused(shelf.client.get("/v1/resolve", params=asked), 404, "robot_not_found")


def test_names_are_unique_among_what_is_in_use(shelf: Shelf) -> None:
    client = shelf.client
    campaign = client.post("/v1/robots/katana/campaigns", json={"name": "monday"}).json()["id"]
    again = client.post("/v1/robots/katana/campaigns", json={"name": "monday"})
    refused(again, 409, "name_taken", "Robot 'katana' has a campaign called 'monday' already", campaign, "--campaign",
            f"kilter measure campaigns retire {campaign}")  # fmt: skip
    assert client.post("/v1/robots/other/campaigns", json={"name": "monday"}).status_code == 201
    numbered = client.post("/v1/robots/katana/campaigns", json={"name": "monday", "numbered": True}).json()
    assert numbered["name"] == "monday (2)"
    client.post(f"/v1/campaigns/{campaign}/retire").raise_for_status()
    second = client.post("/v1/robots/katana/campaigns", json={"name": "monday"}).json()["id"]
    assert shelf.resolve("campaign", "monday", "katana")["id"] == second
    refused(client.post(f"/v1/campaigns/{campaign}/restore"), 409, "name_taken", second)
    client.patch(f"/v1/campaigns/{campaign}", json={"name": "sunday"}).raise_for_status()
    assert client.post(f"/v1/campaigns/{campaign}/restore").json()["retired_at"] is None


@pytest.mark.parametrize("name", ["cmp_monday", "latest", "ver_1", " monday", "job_"])
def test_a_name_that_looks_like_an_id_is_refused(shelf: Shelf, name: str) -> None:
    made = shelf.client.post("/v1/robots/katana/campaigns", json={"name": name})
    refused(made, 400, "name_invalid", repr(name))
    version = shelf.version("0a")
    refused(shelf.client.patch(f"/v1/versions/{version}", json={"name": name}), 400, "name_invalid", repr(name))
    job = {"kind": "identify", "robot": "katana", "name": name, "campaigns": []}
    refused(shelf.client.post("/v1/jobs", json=job), 400, "name_invalid", repr(name))


def test_a_campaign_that_becomes_whole_gets_a_name_of_its_own(shelf: Shelf, katana: Any) -> None:
    client, new = shelf.client, {"name": "long", "staged": True}
    first, second = (client.post("/v1/robots/katana/campaigns", json=new).json()["id"] for _ in range(2))
    names = []
    for campaign in (first, second):
        done = client.post(f"/v1/campaigns/{campaign}/observations", json=katana.columns(3)).json()
        names.append(client.post(f"/v1/campaigns/{campaign}/commit", json={"sha256": [done["sha256"]]}).json()["name"])
    assert names == ["long", "long (2)"]


def test_versions_are_named_and_annotated_and_stay_what_they_are(shelf: Shelf) -> None:
    client, version, other = shelf.client, shelf.version("0a"), shelf.version("0b")
    before = client.get(f"/v1/versions/{version}").json()
    changed = client.patch(
        f"/v1/versions/{version}", json={"name": "after the crash", "notes": "flange replaced"}
    ).json()
    assert (changed["name"], changed["notes"]) == ("after the crash", "flange replaced")
    assert changed == before | {"name": "after the crash", "notes": "flange replaced"}
    assert client.get("/v1/robots/katana/versions").json()["versions"][-1]["name"] == "after the crash"
    assert shelf.resolve("version", "after the crash")["id"] == version
    taken = client.patch(f"/v1/versions/{other}", json={"name": "after the crash"})
    refused(taken, 409, "name_taken", version)
    assert client.patch(f"/v1/versions/{version}", json={"name": ""}).json()["notes"] == "flange replaced"
    assert client.patch(f"/v1/versions/{other}", json={"name": "after the crash"}).status_code == 200
    assert client.patch(f"/v1/versions/{version}", json={"parameters": []}).status_code == 422


def set_columns(database: Database, version: str, change: dict[str, Any]) -> None:
    with database.transaction() as session:
        row = session.get_one(VersionRow, version)
        for key, value in change.items():
            setattr(row, key, value)


def test_what_a_version_says_is_still_immutable(shelf: Shelf) -> None:
    version = shelf.version("0a")
    for change in ({"sha256": "0"}, {"report": {}}, {"name": "a", "limits": {}}, {"robot_sha256": ""}):
        with pytest.raises(RuntimeError, match="immutable"):
            set_columns(shelf.database, version, change)


def test_campaigns_and_robots_are_annotated(shelf: Shelf) -> None:
    campaign = shelf.campaign("646e", "monday")
    assert shelf.client.patch(f"/v1/campaigns/{campaign}", json={"notes": "warm"}).json()["notes"] == "warm"
    assert shelf.client.patch("/v1/robots/katana", json={"remarks": "the left one"}).json()["remarks"] == "the left one"
    listed = {robot["name"]: robot["remarks"] for robot in shelf.client.get("/v1/robots").json()["robots"]}
    assert listed == {"katana": "the left one", "other": ""}


def test_a_retired_campaign_is_out_of_use_and_back(shelf: Shelf, katana: Any) -> None:
    client = shelf.client
    campaign = client.post("/v1/robots/katana/campaigns", json={"name": "monday"}).json()["id"]
    client.post(f"/v1/campaigns/{campaign}/observations", json=katana.columns(5)).raise_for_status()
    version = shelf.version("0a", campaign)
    before = client.get(f"/v1/versions/{version}/residuals").raise_for_status().text
    retired = client.post(f"/v1/campaigns/{campaign}/retire").json()
    assert retired["retired_at"]
    assert client.post(f"/v1/campaigns/{campaign}/retire").json() == retired
    assert client.get("/v1/robots/katana/campaigns").json()["campaigns"] == []
    (shown,) = client.get("/v1/robots/katana/campaigns?retired=true").json()["campaigns"]
    assert shown == retired == client.get(f"/v1/campaigns/{campaign}").json()
    job = {"kind": "identify", "robot": "katana", "campaigns": [campaign]}
    refused(client.post("/v1/jobs", json=job), 409, "retired", campaign, f"kilter measure campaigns restore {campaign}")
    more = client.post(f"/v1/campaigns/{campaign}/observations", json=katana.columns(6))
    refused(more, 409, "retired", campaign)
    assert client.get(f"/v1/versions/{version}/residuals").text == before  # what cites it goes on
    assert shelf.resolve("campaign", "latest", "katana")["code"] == "campaign_not_found"
    assert shelf.resolve("campaign", "monday")["id"] == campaign  # to bring it back
    client.post(f"/v1/campaigns/{campaign}/restore").raise_for_status()
    assert len(client.get("/v1/robots/katana/campaigns").json()["campaigns"]) == 1
    assert client.post("/v1/jobs", json=job).status_code == 202


def test_versions_are_not_compared_on_retired_campaigns(shelf: Shelf, katana: Any) -> None:
    version, kept = shelf.version("0a"), []
    for seed, name in enumerate(("good", "spoilt")):
        campaign = shelf.client.post("/v1/robots/katana/campaigns", json={"name": name}).json()["id"]
        shelf.client.post(f"/v1/campaigns/{campaign}/observations", json=katana.columns(5, seed)).raise_for_status()
        kept.append(campaign)
    shelf.client.post(f"/v1/campaigns/{kept[1]}/retire").raise_for_status()
    with shelf.database.reading() as session:
        assert set(Archive(session, 1).unseen([version]).rows) == {kept[0]}


def test_a_retired_version_is_out_of_use_and_the_active_one_cannot_be_retired(shelf: Shelf) -> None:
    client, first, second = shelf.client, shelf.version("0a"), shelf.version("0b")
    client.post(f"/v1/versions/{first}/activate").raise_for_status()
    refused(client.post(f"/v1/versions/{first}/retire"), 409, "version_active", first, "'katana'", "activate another")
    client.post(f"/v1/versions/{second}/retire").raise_for_status()
    refused(client.post(f"/v1/versions/{second}/activate", json={"force": True}), 409, "retired", second)
    job = {"kind": "evaluate", "robot": "katana", "campaigns": [], "options": {"version": second}}
    job["campaigns"] = [shelf.campaign("646e", "monday")]
    refused(client.post("/v1/jobs", json=job), 409, "retired", second)
    assert [v["id"] for v in client.get("/v1/robots/katana/versions").json()["versions"]] == [first]
    assert len(client.get("/v1/robots/katana/versions?retired=true").json()["versions"]) == 2
    client.post(f"/v1/versions/{second}/restore").raise_for_status()
    client.post(f"/v1/versions/{second}/activate").raise_for_status()
    client.post(f"/v1/versions/{first}/retire").raise_for_status()
    refused(client.post("/v1/robots/katana/rollback"), 409, "nothing_to_roll_back")
    third = shelf.version("0c")
    client.post(f"/v1/versions/{third}/activate").raise_for_status()
    client.post(f"/v1/versions/{second}/retire").raise_for_status()
    client.post(f"/v1/versions/{first}/restore").raise_for_status()
    assert client.post("/v1/robots/katana/rollback").json()["id"] == first  # the retired one is passed over


def test_a_retired_robot_takes_nothing_new_and_goes_on_correcting(shelf: Shelf) -> None:
    client, version, other = shelf.client, shelf.version("0a"), shelf.version("0b")
    campaign = shelf.campaign("646e", "monday")
    client.post(f"/v1/versions/{version}/activate").raise_for_status()
    assert client.post("/v1/robots/katana/retire").json()["retired_at"]
    assert [robot["name"] for robot in client.get("/v1/robots").json()["robots"]] == ["other"]
    assert len(client.get("/v1/robots?retired=true").json()["robots"]) == 2
    for path, body in (
        ("/v1/robots/katana/campaigns", {"name": "b"}),
        ("/v1/jobs", {"kind": "identify", "robot": "katana", "campaigns": [campaign]}),
        (f"/v1/versions/{other}/activate", {}),
    ):
        refused(client.post(path, json=body), 409, "retired", "kilter robot restore katana")
    path = {f"q{j}_deg": [0.0, 1.0] for j in range(1, 6)}
    assert client.post("/v1/robots/katana/correct", json=path).status_code == 200
    client.post("/v1/robots/katana/restore").raise_for_status()
    assert client.post(f"/v1/versions/{other}/activate").status_code == 200


def test_a_purge_is_refused_while_something_cites_it_and_leaves_the_hash(shelf: Shelf, katana: Any) -> None:
    client = shelf.client
    campaign = client.post("/v1/robots/katana/campaigns", json={"name": "monday"}).json()["id"]
    client.post(f"/v1/campaigns/{campaign}/observations", json=katana.columns(5)).raise_for_status()
    version = shelf.version("0a", campaign)
    child = shelf.version("0b", parent=version)
    document = refused(client.post(f"/v1/campaigns/{campaign}/purge"), 409, "cited", version, "campaigns retire")
    assert document["context"]["cited_by"] == [version]
    refused(client.post(f"/v1/versions/{version}/purge"), 409, "cited", child)
    digest = client.get(f"/v1/versions/{child}").json()["sha256"]
    left = client.post(f"/v1/versions/{child}/purge").raise_for_status().json()
    assert (left["kind"], left["sha256"], left["by"], left["robot"]) == ("version", digest, "admin", "katana")
    refused(client.get(f"/v1/versions/{child}"), 404, "version_not_found", "purged by admin on", digest[:12])
    client.post(f"/v1/versions/{version}/purge").raise_for_status()
    client.post(f"/v1/campaigns/{campaign}/purge").raise_for_status()
    refused(client.get(f"/v1/campaigns/{campaign}"), 404, "campaign_not_found", "purged by admin on")
    refused(client.get("/v1/resolve", params={"kind": "campaign", "reference": campaign}), 404, "campaign_not_found",
            "purged by admin on")  # fmt: skip
    refused(client.post(f"/v1/campaigns/{campaign}/purge"), 404, "campaign_not_found")
    kinds = [one["kind"] for one in client.get("/v1/tombstones?robot=katana").json()["tombstones"]]
    assert kinds == ["campaign", "version", "version"]
    assert client.get("/v1/tombstones?robot=other").json()["tombstones"] == []
    assert client.get("/v1/jobs/job_0a").json()["state"] == "succeeded"


def test_a_purge_is_refused_while_a_job_is_not_over_or_the_log_names_it(shelf: Shelf) -> None:
    campaign, version = shelf.campaign("646e", "monday"), shelf.version("0a")
    job = shelf.job("ff", "running", campaigns=[campaign], options={"start": version})
    refused(shelf.client.post(f"/v1/campaigns/{campaign}/purge"), 409, "cited", job)
    refused(shelf.client.post(f"/v1/versions/{version}/purge"), 409, "cited", job)
    other = shelf.version("0c")
    for one in (other, shelf.version("0d")):
        shelf.client.post(f"/v1/versions/{one}/activate").raise_for_status()
    refused(shelf.client.post("/v1/versions/ver_0d/purge"), 409, "version_active", "'katana'")
    refused(shelf.client.post(f"/v1/versions/{other}/purge"), 409, "cited", "the log of activations")


def test_a_robot_is_purged_when_nothing_was_measured_on_it(shelf: Shelf) -> None:
    shelf.campaign("646e", "monday")
    refused(shelf.client.post("/v1/robots/katana/purge"), 409, "robot_in_use", "kilter robot retire katana")
    digest = shelf.client.get("/v1/robots/other").json()["sha256"]
    for _ in range(2):  # a name may be purged, used again and purged again
        left = shelf.client.post("/v1/robots/other/purge").json()
        assert (left["kind"], left["id"], left["sha256"]) == ("robot", "other", digest)
        shelf.client.post("/v1/robots", json=OTHER).raise_for_status()
    assert shelf.client.delete("/v1/robots/other").status_code == 204
    assert len(shelf.client.get("/v1/tombstones").json()["tombstones"]) == 3


def test_a_job_has_a_name_and_gives_it_to_its_version(shelf: Shelf) -> None:
    first = shelf.version("0a", name="monday")
    second = shelf.version("0b", name="monday")  # named while the job ran
    assert shelf.client.get(f"/v1/versions/{first}").json()["name"] == "monday"
    assert shelf.client.get(f"/v1/versions/{second}").json()["name"] == "monday (2)"
    campaign = shelf.campaign("646e", "any")
    job = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "name": "monday"}
    refused(shelf.client.post("/v1/jobs", json=job), 409, "name_taken", first)
    made = shelf.client.post("/v1/jobs", json={**job, "name": "tuesday"}).json()
    assert made["name"] == "tuesday"
    assert shelf.resolve("job", "tuesday", "katana")["id"] == made["id"]
    refused(shelf.client.post("/v1/jobs", json={**job, "name": "tuesday"}), 409, "name_taken", made["id"])
    shelf.client.post(f"/v1/jobs/{made['id']}/cancel").raise_for_status()
    assert shelf.client.post("/v1/jobs", json={**job, "name": "tuesday"}).status_code == 202


@pytest.mark.parametrize("path", ["campaigns/cmp_64", "versions/ver_0", "robots/katana"])
@pytest.mark.parametrize("action", ["retire", "restore", "purge"])
def test_changes_need_the_token_and_take_full_ids(shelf: Shelf, path: str, action: str) -> None:
    shelf.campaign("646e", "monday")
    shelf.version("0a")
    without = shelf.client.post(f"/v1/{path}/{action}", headers={"Authorization": ""})
    assert without.json()["code"] == "token_missing"
    if not path.startswith("robots"):
        assert shelf.client.post(f"/v1/{path}/{action}").status_code == 404
    assert shelf.client.post("/v1/versions/latest/activate").status_code == 404
