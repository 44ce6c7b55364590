"""Names with spaces and umlauts: welcome for files, campaigns, sheets and columns; refused in words for robots."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kilter_client import FileError, Kilter, UsageError, prepare
from kilter_client.cli import run
from kilter_files.robots.exported import checked_name, plain_name
from tests.clients.answered import document
from tests.core.procedures.test_circle_points import circles, horizontal

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Arm Süd", "Arm-Sued"),
        ("Größe 2 (neu)", "Groesse-2-neu"),
        ("ÖFEN", "OeFEN"),
        ("Ärm", "Aerm"),
        ("Señor café", "Senor-cafe"),
        ("機械", "robot"),
        ("u\u0308ber", "ueber"),
        ("a" * 80, "a" * 64),
    ],
)
def test_the_nearest_plain_name(text: str, name: str) -> None:
    assert plain_name(text) == name
    assert checked_name(name) == name
    with pytest.raises(UsageError, match=rf"Give --name {name}; campaigns, files and columns may have any name"):
        checked_name(text)


def test_robots_are_refused_in_words_and_the_remedy_works(kilter: Kilter, capsys: Capture, tmp_path: Path) -> None:
    said = document(capsys, "robot", "add", "--preset", "ur10", "--name", "Arm Süd", code=2)["detail"]
    assert "'Arm Süd'" in said
    assert document(capsys, "robot", "add", "--preset", "ur10", "--name", "Arm-Sued")["name"] == "Arm-Sued"
    path = tmp_path / "robot.json"
    path.write_text(json.dumps({"name": "Arm Süd", "convention": "preset", "preset": "ur10"}))
    assert "Give --name Arm-Sued" in document(capsys, "robot", "add", path, code=2)["detail"]
    assert document(capsys, "robot", "add", path, "--name", "Arm-Sued")["name"] == "Arm-Sued"
    kilter.robots.remove("Arm-Sued")


def test_files_campaigns_notes_and_devices(
    kilter: Kilter, robot: str, write_campaign: Write, capsys: Capture, tmp_path: Path
) -> None:
    path = write_campaign(12, "Messung für Süd, Tag 2.csv")
    done = document(capsys, "upload", robot, path, "--device", "Meßarm Nr. 3", "--notes", "kühl & trocken")
    found = kilter.campaigns.get(done["campaign_id"])
    assert (found["name"], found["device"], found["notes"]) == (path.name, "Meßarm Nr. 3", "kühl & trocken")
    named = document(capsys, "upload", robot, path, "--name", "Prüfling 1 / Größe")
    assert kilter.campaigns.get(named["campaign_id"])["name"] == "Prüfling 1 / Größe"
    assert run(["campaigns", robot]) == 0
    assert "Messung für Süd, Tag 2.csv" in capsys.readouterr().out


def test_a_map_that_is_no_utf_8_is_refused_and_saved_as_such_it_works(tmp_path: Path) -> None:
    data = tmp_path / "Maße.csv"
    data.write_bytes("Größe X;Gelenk 1\n1,5;2\n".encode("latin-1"))
    text = '[file]\nencoding = "latin-1"\ndelimiter = ";"\ndecimal = ","\n[columns]\n'
    text += 'q1_deg = { from = "Gelenk 1", unit = "deg" }\nx_mm = { from = "Größe X", unit = "mm" }\n'
    column_map = tmp_path / "Zuordnung für Süd.toml"
    column_map.write_bytes(text.encode("latin-1"))
    with pytest.raises(FileError, match=r"is not UTF-8 text, as TOML is\. Save it as UTF-8"):
        prepare(data, column_map=column_map)
    column_map.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert prepare(data, column_map=column_map).content == b"q1_deg,x_mm\n2.0,1.5\n"
    column_map.write_text(text.replace('encoding = "latin-1"\n', ""), encoding="utf-8")
    with pytest.raises(FileError, match=r"is not utf-8-sig text .*State its 'encoding', for example \"latin-1\""):
        prepare(data, column_map=column_map)


def test_coupled_circles_from_a_file_with_umlauts(server: Path, capsys: Capture, tmp_path: Path) -> None:
    q, points = circles(horizontal(), np.array([0.2, 0.3, 0.4]), arc=1.2)
    head = [*(f"q{k}_deg" for k in (1, 2, 3)), *(f"m{k}{a}_mm" for k in range(1, points.shape[1] + 1) for a in "xyz")]
    path = tmp_path / "Kreise für Süd.csv"
    table = np.hstack([np.degrees(q), 1e3 * points.reshape(len(q), -1)])
    np.savetxt(path, table, delimiter=",", header=",".join(head), comments="", fmt="%.9f")
    refused = document(capsys, "robot", "from-circles", path, code=1)
    assert "It is joint 3" in refused["detail"]
    assert "--follows j3=j2" in refused["detail"]
    found = document(capsys, "robot", "from-circles", path, "--follows", "J3=J2")
    assert found["robot"]["name"] == "Kreise-fuer-Sued"
    assert found["rms_mm"] < 0.3
