"""What a URDF draws, brought into the frames of Kilter's links and placed by the page's chain, against Pinocchio."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pinocchio
import pytest
import trimesh
from numpy.typing import NDArray

from kilter_files.ground.errors import FileError
from kilter_files.robots.mesh_files import link_meshes
from tests.service.test_urdf import numbers, random_urdf

Floats = NDArray[np.float64]
TETRAHEDRON = np.array([[0.0, 0, 0], [0.2, 0, 0], [0, 0.3, 0], [0, 0, 0.1]])
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
VISUAL = '<visual><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{geometry}</geometry></visual></link>'


def drawn(seed: int, folder: Path, mimic: bool = False) -> str:
    """A random arm, every link with a file (STL, OBJ or DAE) or a box."""
    rng = np.random.default_rng(seed)
    text = random_urdf(seed, mimic)
    for k in range(text.count("</link>")):
        ending = ("stl", "obj", "dae", "")[k % 4]
        geometry = f'<box size="{numbers(rng.uniform(0.1, 0.4, 3))}"/>'
        if ending:
            corners = TETRAHEDRON * rng.uniform(0.5, 2, 3)
            trimesh.Trimesh(corners, FACES, process=False).export(folder / f"{k}.{ending}")
            scale = numbers(rng.uniform(0.5, 2, 3)) if k % 2 else "0.001 0.001 0.001"
            geometry = f'<mesh filename="{k}.{ending}" scale="{scale}"/>'
        place = {"xyz": numbers(rng.normal(0, 0.1, 3)), "rpy": numbers(rng.normal(0, 1, 3))}
        text = text.replace("</inertial></link>", "</inertial>" + VISUAL.format(geometry=geometry, **place), 1)
    (folder / "arm.urdf").write_text(text)
    return text


def by_pinocchio(text: str, folder: Path, angles: dict[str, float]) -> dict[str, Floats]:
    """Corners (N, 3) m of what each of the URDF's links draws, in the base's frame."""
    model = pinocchio.buildModelFromXML(text)
    drawing = pinocchio.buildGeomFromUrdf(
        model, str(folder / "arm.urdf"), pinocchio.GeometryType.VISUAL, package_dirs=[str(folder)]
    )
    q = pinocchio.neutral(model)
    for name, angle in angles.items():
        q[model.joints[model.getJointId(name)].idx_q] = angle
    data, placed = model.createData(), drawing.createData()
    pinocchio.updateGeometryPlacements(model, data, drawing, placed, q)
    found: dict[str, list[Floats]] = {}
    for one, T in zip(drawing.geometryObjects, placed.oMg, strict=True):
        if hasattr(one.geometry, "halfSide"):
            signs = np.array(np.meshgrid(*3 * [[-1, 1]])).reshape(3, -1).T
            corners = signs * one.geometry.halfSide
        else:
            corners = np.array(one.geometry.vertices())  # scaled by Pinocchio
        link = model.frames[one.parentFrame].name
        found.setdefault(link, []).append(corners @ T.rotation.T + T.translation)
    return {link: np.concatenate(corners) for link, corners in found.items()}


def element(name: str, value: float) -> Floats:
    """An elementary transform of the page's chain, mm and degrees."""
    T, k = np.eye(4), "XYZ".index(name[1])
    if name[0] == "T":
        T[k, 3] = value
        return T
    a, b, angle = (k + 1) % 3, (k + 2) % 3, np.radians(value)
    T[a, a], T[a, b], T[b, a], T[b, b] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return T


def frames(arm: dict[str, Any], q: Floats) -> dict[str, Floats]:
    """Where the page draws the mesh of each link: behind the joint's own element."""
    T, found = np.eye(4), {"base": np.eye(4)}
    for k, (name, value, joint, ratio) in enumerate(arm["elements"]):
        T = T @ element(name, value + (0.0 if joint is None or joint < 0 else ratio * q[joint]))
        if k in arm["primary"]:
            found[arm["joints"][arm["primary"].index(k)]["name"]] = T
    return found


@pytest.mark.parametrize("mimic", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_shapes_stand_where_pinocchio_puts_them(seed: int, mimic: bool, client: httpx.Client, tmp_path: Path) -> None:
    text = drawn(seed, tmp_path, mimic)
    document = {"name": "drawn", "convention": "urdf", "urdf": text, "base_link": "base", "tip_link": "tip"}
    client.post("/v1/robots", json=document).raise_for_status()
    asked = client.get("/v1/robots/drawn/urdf-shapes").raise_for_status().json()
    for one in link_meshes(asked["shapes"], tmp_path / "arm.urdf"):
        place = f"/v1/robots/drawn/meshes/{one.link}"
        client.put(place, content=one.content, headers={"Content-Type": "model/stl"}).raise_for_status()
    arm = client.get("/robots/drawn/arm.json").raise_for_status().json()
    names = [joint["name"] for joint in arm["joints"]]
    q = np.random.default_rng(seed).uniform(-1, 1, len(names))  # rad and m
    shown = [
        np.degrees(value) if j["unit"] == "deg" else 1e3 * value for value, j in zip(q, arm["joints"], strict=True)
    ]
    placed = frames(arm, np.array(shown))

    angles = dict(zip(names, q, strict=True))
    angles |= {"joint5": -0.4 * angles["joint0"] + 0.15} if mimic else {}
    expected = by_pinocchio(text, tmp_path, angles)
    of_link = {}
    for shape in asked["shapes"]:
        of_link.setdefault(shape["link"], []).append(shape["urdf_link"])
    assert bool(asked["left_out"]) == mimic
    assert sorted(arm["meshes"]) == sorted(of_link)
    for link, urdf_links in of_link.items():
        content = client.get(f"/v1/robots/drawn/meshes/{link}").content
        corners = np.array(trimesh.load_mesh(io.BytesIO(content), file_type="stl").triangles).reshape(-1, 3)
        ours = corners @ placed[link][:3, :3].T + placed[link][:3, 3]
        theirs = 1e3 * np.concatenate([expected[one] for one in urdf_links])
        nearest = np.linalg.norm(theirs[:, None] - ours[None], axis=2)
        assert nearest.min(axis=1).max() < 1e-3  # mm: single precision of STL
        assert nearest.min(axis=0).max() < 1e-3


def test_files_are_found_in_packages(tmp_path: Path) -> None:
    folder = tmp_path / "arm_description"
    for place in (folder / "meshes", folder / "urdf", tmp_path / "elsewhere"):
        place.mkdir(parents=True)
    for file in (folder / "meshes" / "a.stl", tmp_path / "elsewhere" / "b.stl"):
        trimesh.Trimesh(TETRAHEDRON, FACES).export(file)
    urdf = folder / "urdf" / "arm.urdf"
    shape = {"link": "base", "scale": [1, 1, 1], "transform": np.eye(4).tolist()}
    named = {**shape, "file": "package://arm_description/meshes/a.stl"}
    (one,) = link_meshes([named, {**shape, "file": "../meshes/a.stl"}], urdf)
    assert (one.triangles, one.before) == (8, 8)
    other = {**shape, "file": "package://other/b.stl"}
    with pytest.raises(FileError, match="--package NAME=FOLDER"):
        link_meshes([other], urdf)
    assert link_meshes([other], urdf, {"other": tmp_path / "elsewhere"})[0].triangles == 4
    with pytest.raises(FileError, match="put it where the URDF says"):
        link_meshes([{**shape, "file": "c.stl"}], urdf)
    (folder / "urdf" / "d.stl").write_bytes(b"no mesh")
    with pytest.raises(FileError, match="Write it again as STL, OBJ or DAE"):
        link_meshes([{**shape, "file": "d.stl"}], urdf)


def test_round_shapes_and_what_is_too_fine(tmp_path: Path) -> None:
    at = np.eye(4)
    at[:3, 3] = 10.0, 20.0, 30.0
    shape = {"link": "j1", "scale": [1, 1, 1], "transform": at.tolist(), "file": None}
    cylinder, sphere = {**shape, "cylinder_mm": [5.0, 40.0]}, {**shape, "sphere_mm": 7.0, "link": "j2"}
    found = link_meshes([cylinder, sphere], tmp_path / "arm.urdf")
    for one, half in zip(found, ([5, 5, 20], [7, 7, 7]), strict=True):
        corners = trimesh.load_mesh(io.BytesIO(one.content), file_type="stl").vertices
        np.testing.assert_allclose(corners.min(axis=0), at[:3, 3] - half, atol=0.1)
        np.testing.assert_allclose(corners.max(axis=0), at[:3, 3] + half, atol=0.1)
    trimesh.creation.icosphere(subdivisions=7, radius=0.1).export(tmp_path / "fine.stl")
    (one,) = link_meshes([{**shape, "file": "fine.stl"}], tmp_path / "arm.urdf")
    assert one.before > 300_000
    assert one.triangles <= 100_000
    corners = trimesh.load_mesh(io.BytesIO(one.content), file_type="stl").vertices
    np.testing.assert_allclose(np.linalg.norm(corners - at[:3, 3], axis=1), 100.0, atol=0.5)


def test_a_robot_without_a_urdf_is_told_what_to_do(client: httpx.Client) -> None:
    client.post("/v1/robots", json={"name": "plain", "convention": "preset", "preset": "ur5e"}).raise_for_status()
    answer = client.get("/v1/robots/plain/urdf-shapes")
    assert (answer.status_code, answer.json()["code"]) == (400, "option_invalid")
    assert "kilter robot mesh set" in answer.json()["detail"]


def test_a_shape_that_cannot_be_is_refused_with_its_link(client: httpx.Client, tmp_path: Path) -> None:
    text = drawn(1, tmp_path).replace('scale="0.001 0.001 0.001"', 'scale="0.001"', 1)
    document = {"name": "odd", "convention": "urdf", "urdf": text, "base_link": "base", "tip_link": "tip"}
    client.post("/v1/robots", json=document).raise_for_status()  # it is drawn only: the arm can be used
    answer = client.get("/v1/robots/odd/urdf-shapes")
    assert answer.status_code == 400
    assert "scale='0.001' is not 3 numbers" in answer.json()["detail"]
