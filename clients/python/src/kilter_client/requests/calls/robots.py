"""Calls about robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from kilter_client.requests.steps import Document, Request, Steps, address, answer_of, get, patch, post, read

if TYPE_CHECKING:
    from kilter_files import Prepared

MOST_POSES = 2000  # of one request
MOST_REACHED = 200  # an arm without a closed form takes a twentieth of a second for each


class Reaching(NamedTuple):
    """All joints that bring a flange to a pose, and whether these are surely all."""

    postures: list[Document]
    certain: bool


def add(document: Mapping[str, Any]) -> Steps[Document]:
    """Add a robot."""
    return post("/v1/robots", document)


def today(name: str) -> Steps[Document]:
    """Say how good a robot is today."""
    return get(address("robots", name, "today"))


def bridges(name: str) -> Steps[Document]:
    """Return the bridges of a robot."""
    return get(address("robots", name, "bridges"))


def announce_bridge(name: str, run: str, news: Mapping[str, Any]) -> Steps[Document]:
    """Say what a bridge does."""
    return read(Request("PUT", address("robots", name, "bridges", run), body=news, again=True))


def drift(name: str) -> Steps[Document]:
    """Return the checks of a robot and how it stands by them."""
    return get(address("robots", name, "drift"))


def add_repair(name: str, what: str, at: str | None) -> Steps[Document]:
    """Record what was done to an arm."""
    return post(address("robots", name, "repairs"), {"what": what, "at": at}, again=True)


def remove_repair(name: str, repair: str) -> Steps[None]:
    """Delete a repair that was recorded by mistake."""
    yield from answer_of(Request("DELETE", address("robots", name, "repairs", repair)))


def drifts() -> Steps[Document]:
    """Return how all robots stand by their checks."""
    return get("/v1/drift")


def accept(name: str, wanted: Mapping[str, Any]) -> Steps[Document]:
    """Decide whether a robot keeps a tolerance."""
    given = {key: value for key, value in wanted.items() if value is not None}
    return read(Request("GET", address("robots", name, "acceptance"), params=given))


def check(document: Mapping[str, Any]) -> Steps[Document]:
    """Look at a robot without adding it."""
    return post("/v1/robots/check", document, again=True)


def convert(document: Mapping[str, Any], to: str) -> Steps[Document]:
    """Write a robot in another convention."""
    return read(Request("POST", "/v1/robots/convert", params={"to": to}, body=document, again=True))


def from_circles(rows: Prepared, name: str, convention: str, base: str, follows: Sequence[str]) -> Steps[Document]:
    """Find a robot from rows in which one joint moved at a time."""
    return read(
        Request(
            "POST",
            address("robots", "from-circles"),
            content=rows.content,
            headers={"Content-Type": rows.content_type},
            params={"name": name, "to": convention, "base": base, "follows": [*follows]},
            again=True,
        )
    )


def forward(name: str, joints_deg: Sequence[Sequence[float]]) -> Steps[list[Document]]:
    """Return the nominal flange at rows of joints."""
    rows: list[Document] = []
    for k in range(0, len(joints_deg), MOST_POSES):
        wanted = {"joints_deg": [[*row] for row in joints_deg[k : k + MOST_POSES]]}
        rows += (yield from post(address("robots", name, "forward"), wanted, again=True))["flanges"]
    return rows


def inverse(name: str, flanges: Sequence[Mapping[str, float]]) -> Steps[list[Reaching]]:
    """Return all joints that bring the nominal flange to each of these poses."""
    rows: list[Reaching] = []
    for k in range(0, len(flanges), MOST_REACHED):
        wanted = {"flanges": [{**pose} for pose in flanges[k : k + MOST_REACHED]]}
        found = yield from post(address("robots", name, "inverse"), wanted, again=True)
        certain = found.get("certain") or [True] * len(found["postures"])
        rows += map(Reaching, found["postures"], certain)
    return rows


def frame(points: Mapping[str, Any]) -> Steps[Document]:
    """Find a frame from digitised points."""
    return post("/v1/frames", points, again=True)


def list_robots(retired: bool = False) -> Steps[list[Document]]:
    """Return the robots, by name."""
    found = yield from get("/v1/robots", **also(retired))
    return list(found["robots"])


def one(name: str) -> Steps[Document]:
    """Return a robot."""
    return get(address("robots", name))


def remove(name: str) -> Steps[None]:
    """Delete a robot nothing was measured on."""
    yield from answer_of(Request("DELETE", address("robots", name)))


def note(name: str, remarks: str) -> Steps[Document]:
    """Keep a note with a robot."""
    return patch(address("robots", name), {"remarks": remarks})


def compensate(name: str, compensation: str) -> Steps[Document]:
    """Say whether the controller of a robot corrects by itself."""
    return patch(address("robots", name), {"controller_compensation": compensation})


def do(name: str, what: str) -> Steps[Document]:
    """Retire, restore, purge or roll back a robot."""
    return post(address("robots", name, what))


def also(retired: bool) -> dict[str, str]:
    """Return what asks for retired ones too."""
    return {"retired": "true"} if retired else {}


def stream_session(name: str, stream: str, lifetime_h: float, take_over: bool) -> Steps[Document]:
    """Ask for the keys of a stream."""
    wanted: Document = {"stream": stream, "lifetime_h": lifetime_h}
    if take_over:  # a server of an earlier release does not know the word
        wanted["take_over"] = True
    return post(address("robots", name, "stream", "sessions"), wanted)
