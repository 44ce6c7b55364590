"""`kilter robot mesh`, and the same from the library, against a real server."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
import trimesh

from kilter_client import Kilter, NotFoundError, UsageError, connect_async
from kilter_client.cli import run

URDF = """<robot name="two"><link name="base"/><link name="upper"><visual><origin xyz="0 0 0.1"/><geometry>
<mesh filename="package://two_description/upper.stl" scale="0.001 0.001 0.001"/></geometry></visual></link>
<link name="tip"><visual><geometry><sphere radius="0.05"/></geometry></visual></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1"/></joint>
<joint name="j2" type="revolute"><parent link="upper"/><child link="tip"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1"/></joint></robot>"""


@pytest.fixture
def description(tmp_path: Path) -> Path:
    folder = tmp_path / "two_description"
    (folder / "urdf").mkdir(parents=True)
    (folder / "urdf" / "two.urdf").write_text(URDF)
    trimesh.creation.box(extents=(100, 100, 200)).export(folder / "upper.stl")
    return folder


def test_shapes_from_the_command_line(
    kilter: Kilter, robot: str, description: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, urdf = f"{robot}-two", str(description / "urdf" / "two.urdf")
    assert run(["robot", "add", urdf, "--name", name, "--base-link", "base", "--tip-link", "tip"]) == 0
    capsys.readouterr()
    assert run(["mesh", "list", name]) == 0
    assert "drawn as cylinders" in capsys.readouterr().out
    assert run(["mesh", "from-urdf", name, urdf, "--json"]) == 0
    sent = json.loads(capsys.readouterr().out)
    assert [(one["link"], one["triangles"]) for one in sent["meshes"]] == [("j1", 12), ("j2", 1280)]
    assert run(["mesh", "set", name, "base", str(description / "upper.stl"), "--unit", "m"]) == 0
    assert run(["mesh", "remove", name, "j2"]) == 0
    capsys.readouterr()
    assert run(["mesh", "list", name, "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["meshes"]
    assert [(one["link"], one["unit"]) for one in listed] == [("base", "m"), ("j1", "mm")]


def test_refusals_name_the_remedy(
    kilter: Kilter, robot: str, description: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf, step = str(description / "urdf" / "two.urdf"), description / "arm.step"
    step.write_text("ISO-10303-21;")
    for command, status, words in (
        (["from-urdf", robot, urdf], 1, "kilter robot mesh set"),
        (["set", robot, "j1", str(step)], 2, "ends in .stl or .obj"),
        (["set", robot, "elbow", str(description / "upper.stl")], 1, "There are base, "),
        (["remove", robot, "base"], 1, "`kilter robot mesh list ROBOT`"),
        (["from-urdf", robot, urdf, "--package", "here"], 2, "give NAME=FOLDER"),
    ):
        assert run(["mesh", *command]) == status
        assert words in " ".join(capsys.readouterr().err.split())


def test_shapes_from_the_library(kilter: Kilter, robot: str, description: Path) -> None:
    urdf = description / "urdf" / "two.urdf"
    arm = kilter.add_robot(urdf, name=f"{robot}-two", base_link="base", tip_link="tip")
    made = kilter.set_urdf_meshes(arm, urdf, packages={"two_description": description})
    assert [one.link for one in made] == [one.link for one in kilter.meshes(arm)] == ["j1", "j2"]
    assert kilter.set_mesh(arm, "j2", description / "upper.stl").triangles == 12
    kilter.remove_mesh(arm, "j2")
    with pytest.raises(NotFoundError, match="has no mesh"):
        kilter.remove_mesh(arm, "j2")
    with pytest.raises(UsageError, match="ends in"):
        kilter.set_mesh(arm, "j2", urdf)

    async def listed() -> list[str]:
        async with connect_async() as k:
            return [one.link for one in await k.meshes(arm)]

    assert asyncio.run(listed()) == ["j1"]
