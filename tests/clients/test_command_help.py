"""`kilter --help` and its lists: every command under a heading on one line, and what there is without a server."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import typer

from kilter_client.cli import run
from kilter_client.cli.catalogue import ENTRIES, FIRST, GROUPS, MADE, MOVED
from kilter_core.arm.presets import preset_names
from kilter_core.effects import EFFECTS
from kilter_core.identify.registry import METHODS
from kilter_core.motion.effects import MOTION_EFFECTS
from kilter_service.ground.tables import columns as contract
from kilter_service.robots.exporters.registry import FORMATS as EXPORTS

Capture = pytest.CaptureFixture[str]


def printed(capsys: Capture, *arguments: str, code: int = 0) -> str:
    assert run(arguments) == code
    return capsys.readouterr().out


def listed(capsys: Capture, name: str) -> list[dict[str, str]]:
    found = json.loads(printed(capsys, name, "--json"))[name]
    assert isinstance(found, list)
    return found


def test_the_first_level_is_short_and_each_command_on_one_line(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = printed(capsys, "--help")
    assert max(map(len, text.splitlines())) <= 80
    assert "First time: robot add, upload, gap, activate, correct, check." in text
    commands, groups = (
        re.search(rf"^{heading}.*:\n((?:  .+\n)+)", text, re.MULTILINE) for heading in ("Commands", "Groups")
    )
    assert commands
    assert groups
    lines = commands[1].splitlines() + groups[1].splitlines()
    assert len(FIRST) <= 16
    assert sorted(line.split()[0] for line in lines) == sorted((*FIRST, *(set(MADE) - set(MOVED))))
    assert all(line.endswith(".") for line in lines)


def test_every_command_is_in_reach_once() -> None:
    inside = [old for group in GROUPS.values() for old in (*group.commands.values(), group.own)]
    known = [*inside, *(name for name in (*FIRST, *MADE) if name not in GROUPS and name not in MOVED)]
    assert sorted(filter(None, known)) == sorted(ENTRIES)


@pytest.mark.parametrize("old", MOVED)
def test_an_old_spelling_works_and_says_the_new_one(old: str, capsys: Capture) -> None:
    assert run([old, "--help"]) == 0
    now = capsys.readouterr()
    assert f"`kilter {old}` is now `kilter {MOVED[old]}`" in now.err
    assert run([*MOVED[old].split(), "--help"]) == 0
    there = capsys.readouterr()
    assert there.err == ""
    if old != "versions":  # whose commands stand beside others now
        assert now.out.partition("\n")[2] == there.out.partition("\n")[2]
    assert f"Usage: kilter {MOVED[old]} " in there.out


def test_an_old_spelling_says_nothing_more_with_json(no_settings: None, capsys: Capture) -> None:
    assert run(["effects", "--json"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("group", GROUPS)
def test_a_group_alone_shows_its_commands(group: str, capsys: Capture) -> None:
    assert run([group]) == 2
    assert capsys.readouterr().err.startswith(f"Usage: kilter {group} ")


def test_the_catalogue_lists_what_the_modules_register() -> None:
    for module in {entry.module for entry in ENTRIES.values()}:
        alone = typer.Typer()
        alone.callback()(lambda: None)
        import_module(f"kilter_client.cli.{module}").register(alone)
        found: Any = typer.main.get_command(alone)
        assert set(found.commands) == {name for name, entry in ENTRIES.items() if entry.module == module}


@pytest.mark.parametrize("group", [*GROUPS, "jobs", "campaigns", "versions"])
def test_groups_cut_no_line(group: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = printed(capsys, group, "--help").partition("Commands:\n")[2].splitlines()
    assert lines
    assert all(re.fullmatch(r"  [a-z-]+ +[A-Z].*\.", line) and len(line) <= 80 for line in lines), lines


def test_without_a_command_there_is_help(capsys: Capture) -> None:
    assert "Commands:" in printed(capsys, code=2)
    assert "Give a command" in json.loads(printed(capsys, "--json", code=2))["detail"]
    assert "kilter jobs ... --json" in json.loads(printed(capsys, "--json", "jobs", code=2))["detail"]


def test_the_version_without_a_server(no_settings: None, capsys: Capture) -> None:
    text = printed(capsys, "--version")
    assert re.match(r"kilter \d+\.\d+", text)
    assert "no server: No server is known" in text
    assert json.loads(printed(capsys, "--version", "--json"))["server"] is None


def test_the_version_with_a_server(server: Path, capsys: Capture) -> None:
    found = json.loads(printed(capsys, "--version", "--json"))
    assert re.match(r"\d+\.\d+", found["server"])
    assert f"server {found['server']} at {found['url']}" in printed(capsys, "--version")
    program = Path(sys.executable).with_name("kilterd")
    said = subprocess.run([program, "--version"], capture_output=True, text=True, check=True).stdout
    assert said == f"kilterd {found['server']}\n"


def test_lists_hold_what_there_is(no_settings: None, capsys: Capture) -> None:
    effects = {effect["id"]: effect for effect in listed(capsys, "effects")}
    of_torques = {effect.id: effect for effect in MOTION_EFFECTS}
    assert set(effects) == (set(EFFECTS) - {"load_error"}) | set(of_torques)  # which nobody asks for
    assert all("log of torques" in effects[name]["needs"] for name in of_torques)
    assert effects["backlash"]["acts_on"] == "joints"
    assert effects["measurement_scale"]["acts_on"] == "instrument"
    assert all(
        (effect["needs"] != "") == bool(EFFECTS[name].needs) for name, effect in effects.items() if name in EFFECTS
    )
    assert [method["id"] for method in listed(capsys, "methods")] == list(METHODS)
    presets = {preset["id"]: preset for preset in listed(capsys, "presets")}
    assert set(presets) == set(preset_names())
    assert (presets["panda"]["joints"], presets["irb120"]["masses"]) == ("7", "no masses")
    formats = listed(capsys, "formats")
    assert {form["id"] for form in formats if form["use"] == "export --format"} == set(EXPORTS)
    assert any(form["use"] == "upload --map" and ".xlsx" in form["endings"].split() for form in formats)
    assert all(form["what"] for form in formats)


def test_columns_are_the_contracts(no_settings: None, capsys: Capture) -> None:
    for column in listed(capsys, "columns"):
        names = [name for name in re.findall(r"\b[a-z]\w*\b", column["columns"]) if name != "and"]
        assert names
        for name in names:  # an unknown name is refused; "qn_deg" stands for the last joint
            contract._read(re.sub(r"^(q|link|cmd|dir)n", r"\g<1>9", name), ["revolute"] * 9)


@pytest.mark.parametrize("name", ["effects", "methods", "presets", "formats", "columns"])
def test_lists_have_one_line_each(name: str, no_settings: None, capsys: Capture) -> None:
    rows = len(listed(capsys, name))
    assert len([line for line in printed(capsys, name).splitlines() if line.strip()]) == rows + 2
