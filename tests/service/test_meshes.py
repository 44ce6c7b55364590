"""Meshes of links: read strictly, kept as they were sent, and refused with words."""

from __future__ import annotations

import hashlib
import struct

import httpx
import numpy as np
import pytest

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import MAX_TRIANGLES
from kilter_service.robots.meshes.service import triangles

from .conftest import Katana

STL, OBJ = {"Content-Type": "model/stl"}, {"Content-Type": "model/obj"}
CORNERS = [[[0, 0, 0], [10, 0, 0], [0, 10, 0]], [[0, 0, 0], [0, 10, 0], [0, 0, 10]]]
TEXT = b"""# a pyramid
v 0 0 0
v 10 0 0 1
v 0 10 0
v 0 0 10
vn 0 0 1
f 1//1 2//1 3//1
f -4 -2 -1
"""


def binary(corners: list[list[list[float]]], head: bytes = b"solid looks like text") -> bytes:
    parts = [head.ljust(80, b" "), struct.pack("<I", len(corners))]
    parts += [struct.pack("<12fH", 0, 0, 0, *(value for point in one for value in point), 0) for one in corners]
    return b"".join(parts)


def text(corners: list[list[list[float]]]) -> bytes:
    lines = ["solid a"]
    for one in corners:
        lines += [
            "facet normal 0 0 0",
            "outer loop",
            *(f"vertex {x} {y} {z}" for x, y, z in one),
            "endloop",
            "endfacet",
        ]
    return "\n".join([*lines, "endsolid a"]).encode()


@pytest.mark.parametrize(
    "content", [(binary(CORNERS), "stl"), (text(CORNERS), "stl"), (TEXT, "obj")], ids=["binary", "text", "obj"]
)
def test_each_format_gives_the_same_triangles(content: tuple[bytes, str]) -> None:
    np.testing.assert_array_equal(triangles(*content), np.array(CORNERS, dtype=np.float64))


def test_a_face_of_many_corners_becomes_triangles() -> None:
    square = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
    assert triangles(square, "obj").tolist() == [
        [[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("content", "form", "why"),
    [
        (b"", "stl", "0 triangles"),
        (binary(CORNERS, b"")[:-1], "stl", "2 triangles, which are 184 bytes, and has 183"),
        (binary([]), "stl", "no triangle"),
        (binary(CORNERS, b"")[:80] + struct.pack("<I", 2**31), "stl", "bytes"),
        (binary([[[0, 0, float("nan")], [1, 0, 0], [0, 1, 0]]]), "stl", "not a number"),
        (binary([[[0, 0, 1e30], [1, 0, 0], [0, 1, 0]]]), "stl", "beyond"),
        (binary([[[1, 1, 1]] * 3]), "stl", "the same point"),
        (text(CORNERS).replace(b"vertex 10 0 0\n", b""), "stl", "other than three corners"),
        (text(CORNERS).replace(b"vertex 10 0 0", b"vertex 10 zero 0"), "stl", "no three numbers"),
        (b"v 0 0 0\nf 1 2 3\n", "obj", "line 2 names point '2'"),
        (b"v 0 0 0\nf 0 1 1\n", "obj", "names point '0'"),
        (b"v 0 0 0\nv 1 0 0\nf 1 2\n", "obj", "fewer than 3 corners"),
        (b"v 0 0 inf\n", "obj", "no three numbers"),
        (b"\xff\xfe\x00", "obj", "neither a binary STL nor text"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * (MAX_TRIANGLES + 1), "obj", "more than"),
    ],
)  # fmt: skip
def test_what_is_no_mesh_is_refused_with_the_place(content: bytes, form: str, why: str) -> None:
    with pytest.raises(ServiceError, match="cannot be a mesh") as refused:
        triangles(content, form)
    assert why in refused.value.message
    assert refused.value.code == "mesh_invalid"


def test_nothing_but_a_refusal_comes_of_damaged_files() -> None:
    rng = np.random.default_rng(7)
    for form, whole in (("stl", binary(CORNERS)), ("stl", text(CORNERS)), ("obj", TEXT)):
        for _ in range(400):
            damaged = bytearray(whole[: rng.integers(0, len(whole) + 1)] if rng.random() < 0.4 else whole)
            for place in rng.integers(0, len(damaged), 3) if damaged else []:
                damaged[place] = rng.integers(0, 256)
            try:
                found = triangles(bytes(damaged), form)
            except ServiceError as error:
                assert error.code == "mesh_invalid"  # noqa: PT017 (either is right)
            else:
                assert found.shape[1:] == (3, 3)
                assert np.isfinite(found).all()


@pytest.fixture
def arm(client: httpx.Client, katana: Katana) -> str:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    return f"/v1/robots/{katana.name}/meshes"


def test_a_mesh_is_kept_as_it_was_sent(client: httpx.Client, arm: str) -> None:
    content = binary(CORNERS)
    made = client.put(f"{arm}/j2", params={"unit": "m"}, content=content, headers=STL).raise_for_status().json()
    assert (made["link"], made["format"], made["unit"], made["triangles"]) == ("j2", "stl", "m", 2)
    assert made["sha256"] == hashlib.sha256(content).hexdigest()
    client.put(f"{arm}/base", content=TEXT, headers=OBJ).raise_for_status()
    assert [one["link"] for one in client.get(arm).json()["meshes"]] == ["base", "j2"]
    got = client.get(f"{arm}/j2")
    assert (got.content, got.headers["content-type"]) == (content, "model/stl")
    client.put(f"{arm}/j2", content=TEXT, headers=OBJ).raise_for_status()
    assert client.get(f"{arm}/j2").content == TEXT
    assert client.delete(f"{arm}/j2").status_code == 204
    assert client.get(f"{arm}/j2").json()["code"] == "mesh_not_found"
    assert client.delete(f"{arm}/j2").json()["code"] == "mesh_not_found"


def test_a_mesh_goes_with_its_robot(client: httpx.Client, arm: str) -> None:
    client.put(f"{arm}/j1", content=TEXT, headers=OBJ).raise_for_status()
    client.delete(arm.removesuffix("/meshes")).raise_for_status()
    assert client.get(arm).json()["code"] == "robot_not_found"


@pytest.mark.parametrize(
    ("link", "headers", "content", "code"),
    [
        ("j9", STL, binary(CORNERS), "option_invalid"),
        ("j1", {"Content-Type": "text/plain"}, TEXT, "media_type_unsupported"),
        ("j1", STL, TEXT, "mesh_invalid"),
        ("j1", STL, bytes(17 << 20), "upload_too_large"),
        ("j1", {**STL, "Content-Digest": f"sha-256=:{'A' * 43}=:"}, binary(CORNERS), "digest_mismatch"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_is_stored(
    shared_client: httpx.Client, katana: Katana, link: str, headers: dict[str, str], content: bytes, code: str
) -> None:
    shared_client.post("/v1/robots", json={**katana.document, "name": "bare"}).raise_for_status()
    arm = "/v1/robots/bare/meshes"
    assert shared_client.put(f"{arm}/{link}", content=content, headers=headers).json()["code"] == code
    assert shared_client.get(arm).json()["meshes"] == []


@pytest.mark.both_databases
def test_meshes_are_stored_in_either_database(client: httpx.Client, arm: str) -> None:
    client.put(f"{arm}/j3", content=binary(CORNERS), headers=STL).raise_for_status()
    assert client.get(f"{arm}/j3").content == binary(CORNERS)
