"""Calls about the shapes of a robot's links."""

from __future__ import annotations

from typing import Literal

from kilter_client.requests.steps import Document, Request, Steps, address, get, read, send_with_retries

Form = Literal["stl", "obj"]


def list_meshes(robot: str) -> Steps[list[Document]]:
    """Return the shapes of a robot's links, from base to tool."""
    found = yield from get(address("robots", robot, "meshes"))
    return list(found["meshes"])


def put(robot: str, link: str, content: bytes, form: Form, unit: str) -> Steps[Document]:
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


def remove(robot: str, link: str) -> Steps[None]:
    """Delete the shape of a link."""
    yield from send_with_retries(Request("DELETE", address("robots", robot, "meshes", link)))


def of_urdf(robot: str) -> Steps[Document]:
    """Return what the robot's URDF draws: files, and where each goes."""
    return get(address("robots", robot, "urdf-shapes"))
