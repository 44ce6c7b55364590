"""Calls about robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from kilter_client.requests.steps import Document, Request, Steps, address, get, patch, post, read, send_with_retries

if TYPE_CHECKING:
    from kilter_files import Prepared


MOST_POSES = 2000  # of one request
MOST_REACHED = 200  # an arm without a closed form takes a twentieth of a second for each


class Reaching(NamedTuple):
    """All joints that bring a flange to a pose, and whether these are surely all."""

    postures: list[Document]
    certain: bool


def add(document: Mapping[str, Any]) -> Steps[Document]:
    """Add a robot (the contract's ``robot.json``); the same document twice changes nothing."""
    return post("/v1/robots", document)


def today(name: str) -> Steps[Document]:
    """Return how good a robot is today, and what is missing in its active version."""
    return get(address("robots", name, "today"))


def bridges(name: str) -> Steps[Document]:
    """Return the bridges of a robot: those that run first."""
    return get(address("robots", name, "bridges"))


def announce_bridge(name: str, run: str, news: Mapping[str, Any]) -> Steps[Document]:
    """Say to the server what the bridge of this ``run`` does; it is shown, and controls nothing."""
    return read(Request("PUT", address("robots", name, "bridges", run), body=news, again=True))


def drift(name: str) -> Steps[Document]:
    """Return the checks of a robot and how it stands by them."""
    return get(address("robots", name, "drift"))


def add_repair(name: str, what: str, at: str | None) -> Steps[Document]:
    """Record what was done to an arm."""
    return post(address("robots", name, "repairs"), {"what": what, "at": at}, again=True)


def remove_repair(name: str, repair: str) -> Steps[None]:
    """Delete a repair that was recorded by mistake."""
    yield from send_with_retries(Request("DELETE", address("robots", name, "repairs", repair)))


def drifts() -> Steps[Document]:
    """Return how all robots stand by their checks, the worst first."""
    return get("/v1/drift")


def accept(name: str, wanted: Mapping[str, Any]) -> Steps[Document]:
    """Decide whether a robot keeps a tolerance."""
    given = {key: value for key, value in wanted.items() if value is not None}
    return read(Request("GET", address("robots", name, "acceptance"), params=given))


def check(document: Mapping[str, Any]) -> Steps[Document]:
    """Return what a document comes to, without adding it: axes, the arm at zero, reach, what looks wrong."""
    return post("/v1/robots/check", document, again=True)


def convert(document: Mapping[str, Any], to: str) -> Steps[Document]:
    """Return the same arm as a document of convention ``to`` (chain, dh, mdh, s_model, poe, cpc, mcpc, urdf)."""
    return read(Request("POST", "/v1/robots/convert", params={"to": to}, body=document, again=True))


def from_circles(
    rows: Prepared, name: str, convention: str = "chain", base: str = "axis", follows: Sequence[str] = ()
) -> Steps[Document]:
    """Find a robot from rows in which one joint moved at a time: its document as ``robot``, and its ``axes``.

    ``follows`` are pairs "j3=j2" of joints that are read against the horizontal.
    """
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
    """Find a frame from digitised ``points`` or ``features``: its ``pose``, and how far each point is off."""
    return post("/v1/frames", points, again=True)


def list_robots(retired: bool = False) -> Steps[list[Document]]:
    """Return the robots, by name; with ``retired`` also those that are out of use."""
    found = yield from get("/v1/robots", retired=retired or None)
    return list(found["robots"])


def fetch_document(name: str) -> Steps[Document]:
    """Return a robot with its joints, parameters and document."""
    return get(address("robots", name))


def remove(name: str) -> Steps[None]:
    """Delete a robot nothing was measured on."""
    yield from send_with_retries(Request("DELETE", address("robots", name)))


def note(name: str, remarks: str) -> Steps[Document]:
    """Add a note to a robot, replacing the previous one."""
    return patch(address("robots", name), {"remarks": remarks})


def compensate(name: str, compensation: str) -> Steps[Document]:
    """Say whether the controller of a robot corrects by itself: none, factory, kilter or unknown."""
    return patch(address("robots", name), {"controller_compensation": compensation})


def set_tolerance(name: str, tolerance_mm: float | None, check_interval_days: int | None) -> Steps[Document]:
    """Say how good a robot must be, and within how many days it is to be checked; None takes either away."""
    return patch(address("robots", name), {"tolerance_mm": tolerance_mm, "check_interval_days": check_interval_days})


def do(name: str, what: str) -> Steps[Document]:
    """Retire, restore, purge or roll back a robot."""
    return post(address("robots", name, what))


def stream_session(
    name: str, stream: str = "main", lifetime_h: float = 24.0, take_over: bool = False
) -> Steps[Document]:
    """Return id and keys of a new session of a stream; whoever has them can send setpoints on it.

    A stream that somebody else holds is refused, unless it is taken over: that ends the other's session.
    """
    wanted: Document = {"stream": stream, "lifetime_h": lifetime_h}
    if take_over:  # a server of an earlier release does not know the word
        wanted["take_over"] = True
    return post(address("robots", name, "stream", "sessions"), wanted)


Form = Literal["stl", "obj"]


def list_meshes(robot: str) -> Steps[list[Document]]:
    """Return the shapes of a robot's links, from base to tool."""
    found = yield from get(address("robots", robot, "meshes"))
    return list(found["meshes"])


def put_mesh(robot: str, link: str, content: bytes, form: Form, unit: str) -> Steps[Document]:
    """Give a link its shape."""
    request = Request(
        "PUT",
        address("robots", robot, "meshes", link),
        params={"unit": unit},
        content=content,
        again=True,
        headers={"Content-Type": f"model/{form}"},
    )
    return read(request)


def remove_mesh(robot: str, link: str) -> Steps[None]:
    """Delete the shape of a link."""
    yield from send_with_retries(Request("DELETE", address("robots", robot, "meshes", link)))


def list_urdf_meshes(robot: str) -> Steps[Document]:
    """Return what the robot's URDF draws: files, and where each goes."""
    return get(address("robots", robot, "urdf-shapes"))
