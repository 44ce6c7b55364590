"""A log of joint torques from a file to its answer: a real server, the command, the page, and files that cannot be searched."""

from __future__ import annotations

import ctypes
import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.errors import ConflictError, JobFailedError, NotFoundError, ObservationError
from kilter_core.observations import Observations
from tests.core.identify.test_carried_masses import ASKED, SOFT, measured, standing
from tests.core.motion.moving_arm import Logger, State, ur_like
from tests.core.motion.test_find import HIDDEN, at_joint
from tests.core.motion.test_loads import solid
from tests.core.motion.test_wrist import BIAS, CENTRE, MASS, MOUNTING, ORIGIN, Wrist
from tests.core.truth import Body, Floats

Capture = pytest.CaptureFixture[str]
JOINTS = range(1, 7)
HEAD = ["t_s", *(f"q{j}_deg" for j in JOINTS), *(f"tau{j}_nm" for j in JOINTS)]


@pytest.fixture(scope="module")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> tuple[Logger, Path]:
    """An arm and the file of a log of it, in which a ripple of joint 3 is hidden."""
    logger = Logger(ur_like(np.random.default_rng(7)), seed=7)
    joint, shape = HIDDEN["gear_ripple"]
    logger.extra = [at_joint(joint, shape, 1.5)(logger)]
    log = logger.log()
    path = tmp_path_factory.mktemp("log") / "log.csv"
    columns = np.column_stack([log["t"], np.degrees(log["q"]), log["tau"]])
    np.savetxt(path, columns, delimiter=",", header=",".join(HEAD), comments="", fmt="%.7g")
    return logger, path


@pytest.fixture
def logged(server: Path, hidden: tuple[Logger, Path]) -> Path:
    """The file, once the server knows the robot ``mover``."""
    del server
    logger, path = hidden
    with Kilter() as kilter:
        try:
            kilter.robots.get("mover")
        except NotFoundError:
            kilter.robots.add(logger.arm.document() | {"name": "mover"})
    return path


def test_a_log_is_uploaded_and_its_missing_effect_named(server: Path, logged: Path, capsys: Capture) -> None:
    assert run(["upload", "mover", str(logged), "--name", "log"]) == 0
    capsys.readouterr()
    assert run(["gap", "mover", "-c", "log"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("Found: gear ripple of joint 3")
    assert "Torque error of joint 3 on motions that were never used" in printed.out
    assert "Warning" not in printed.out
    assert len(printed.out.splitlines()) <= 25
    last = printed.out.splitlines()[-1]
    assert last == "Next, to see the same in a second log: kilter plan motion mover -o motions.csv"
    assert run(["gap", "mover", "-c", "log", "--details"]) == 0
    assert "coulomb_friction_6" in capsys.readouterr().out
    assert run(["gap", "mover", "-c", "log", "--json"]) == 0
    job = json.loads(capsys.readouterr().out)
    result = job["result"]
    assert [(one["id"], one["joints"], one["verdict"]) for one in result["effects"]] == [
        ("gear_ripple", [3], "confirmed")
    ]
    (third,) = [one for one in result["motion"]["joints"] if one["joint"] == 3]
    assert third["found"] < 0.9 * third["friction"] < third["rigid"]
    assert result["version_id"] is None
    assert ("motor_inertia", [1]) in [(one["id"], one["joints"]) for one in result["not_testable"]]
    with Kilter() as kilter, httpx.Client(base_url=kilter.url) as page:
        page.post("/login", data={"token": (server / "token").read_text().splitlines()[0]})
        text = page.get(f"/jobs/{job['id']}").raise_for_status().text
    assert "What is left of the torques" in text
    assert "rms error before" not in text


def test_torques_of_a_path_come_from_the_newest_search(
    server: Path, hidden: tuple[Logger, Path], logged: Path, tmp_path: Path, capsys: Capture
) -> None:
    logger, _ = hidden
    document = logger.arm.document() | {"name": "driven"}
    path, out = tmp_path / "path.csv", tmp_path / "torques.csv"
    t = np.arange(0.0, 5.0, 0.01)
    q, qd, qdd = logger._path(t)
    np.savetxt(path, np.column_stack([t, np.degrees(q)]), delimiter=",", header=",".join(HEAD[:7]), comments="")
    with Kilter() as kilter:
        kilter.robots.add(document)
        with pytest.raises(ConflictError, match="No search in torques") as refused:
            kilter.torques("driven", path)
        assert refused.value.code == "no_torque_model"
        kilter.upload("driven", logged, name="log")
        kilter.gap("driven", "log", name="by log")
        assert run(["robot", "torque", "driven", str(path), "-o", str(out)]) == 0
        assert "by log" in capsys.readouterr().err
        rows = np.genfromtxt(out, delimiter=",", names=True)
        told = np.stack([rows[f"tau{j}_nm"] for j in JOINTS], axis=1)
        joint, shape = HIDDEN["gear_ripple"]
        ripple = at_joint(joint, shape, 1.5)(logger)
        state = State(q, qd, qdd, logger._rigid(q, qd, qdd), t)
        right = state.rigid + logger.friction.torque(state) + ripple(state)
        wrong = np.sqrt(np.mean((told - right)[20:-20] ** 2, axis=0))
        assert np.all(wrong < 0.02 * logger.usual + 0.1 * right.std(axis=0))
        heavy = kilter.torques(
            "driven", {"t_s": t, **{f"q{j}_deg": np.degrees(q[:, j - 1]) for j in JOINTS}}, payload_kg=5
        )
        assert np.abs(heavy.to_numpy()["tau2_nm"] - told[:, 1]).max() > 10.0
        with pytest.raises(ObservationError, match="t_s"):
            kilter.torques("driven", {f"q{j}_deg": np.zeros(8) for j in JOINTS})


def test_poses_lean_on_the_masses_that_torques_told(server: Path, capsys: Capture) -> None:
    document = solid().document() | {"name": "leaning"}
    for link in document["links"]:
        link["mass_kg"] *= 1.25
    log = Logger(solid(), seed=21).log()
    table = {"t_s": log["t"]} | {f"q{j}_deg": np.degrees(log["q"][:, j - 1]) for j in JOINTS}
    table |= {f"tau{j}_nm": log["tau"][:, j - 1] for j in JOINTS}
    rows = measured(standing(), 8)
    points = {f"q{j}_deg": np.degrees(rows.q[:, j - 1]) for j in JOINTS}
    points |= {f"{axis}_mm": 1e3 * rows.position[:, k] for k, axis in enumerate("xyz")}
    with Kilter() as kilter:
        kilter.robots.add(document)
        kilter.upload("leaning", points, name="poses")
        with pytest.raises(ConflictError, match="No search in torques") as refused:
            kilter.identify("leaning", "poses", effects=[ASKED], masses_from="newest")
        assert refused.value.code == "no_torque_model"
        kilter.upload("leaning", table, name="log")
        kilter.gap("leaning", "log", name="by log")
        kilter.gap("leaning", "poses", budget_s=1.0)  # newer, and not in torques
        found = {}
        for given in (None, "newest"):
            version = kilter.identify("leaning", "poses", effects=[ASKED], masses_from=given)
            found[given] = {p["name"]: p["value"] for p in version["parameters"]}
        (searched,) = (one["id"] for one in kilter.jobs.list("leaning") if one["name"] == "by log")
        assert (
            kilter.jobs.get(kilter.versions.get(version["version_id"])["job_id"])["options"]["masses_from"] == searched
        )
        assert (
            run(["identify", "leaning", "-c", "poses", "--effects", "axial_compliance", "--masses-from", "newest"]) == 0
        )
        line = "Masses and centres of the links are from torques: search by log."
        assert line in capsys.readouterr().out.splitlines()
        assert line in kilter.versions.get(version["version_id"])["headline"].splitlines()
        with httpx.Client(base_url=kilter.url) as page:
            page.post("/login", data={"token": (server / "token").read_text().splitlines()[0]})
            made = kilter.versions.get(version["version_id"])["job_id"]
            assert line in page.get(f"/jobs/{made}").raise_for_status().text
            form = page.get("/robots/leaning/jobs?kind=gap").raise_for_status().text
            assert f'<option value="{searched}">by log</option>' in form
        plain = kilter.identify("leaning", "poses", level=1, masses_from=searched)
        assert "from torques" not in plain["headline"]
        assert any(one["message"].startswith("masses_from did nothing") for one in plain["warnings"])
        sought = kilter.gap("leaning", "poses", budget_s=1.0, masses_from="newest")
        assert line in sought["headline"].splitlines()
    right = {f"compliance_{j}": np.degrees(SOFT[j]) for j in (2, 3)}
    wrong = {given: [abs(one[name] / c - 1.0) for name, c in right.items()] for given, one in found.items()}
    assert max(wrong["newest"]) < 0.04 < max(wrong[None])


def test_a_version_holds_the_torques_of_a_log_that_started_from_it(
    server: Path, tmp_path: Path, capsys: Capture
) -> None:
    logger = Logger(solid(), seed=22)
    log, rows = logger.log(), measured(standing(), 8)
    table = {"t_s": log["t"]} | {f"q{j}_deg": np.degrees(log["q"][:, j - 1]) for j in JOINTS}
    table |= {f"tau{j}_nm": log["tau"][:, j - 1] for j in JOINTS}
    points = {f"q{j}_deg": np.degrees(rows.q[:, j - 1]) for j in JOINTS}
    points |= {f"{axis}_mm": 1e3 * rows.position[:, k] for k, axis in enumerate("xyz")}
    path = path_of(logger)
    with Kilter() as kilter:
        kilter.robots.add(solid().document() | {"name": "holding"})
        kilter.upload("holding", points, name="poses")
        kilter.upload("holding", table, name="log")
        first = kilter.identify("holding", "poses", name="plain")["version_id"]
        with pytest.raises(ConflictError, match="holds no torques") as refused:
            kilter.torques("holding", path, version=first)
        assert refused.value.code == "no_torque_model"
        kilter.versions.activate(first, force=True, reason="a test of torques")
        found = kilter.identify("holding", "log", start=first, name="by log")
        assert not any(one["code"] == "options_unused" for one in found["warnings"])
        second = found["version_id"]
        held, before = (json.loads(kilter.versions.export(one, "json")) for one in (second, first))
        model = held["calibration_si"].pop("torques")
        assert held["calibration_si"] == before["calibration_si"]  # the tool is corrected as before
        assert held["version"]["limits"] == before["version"]["limits"]
        assert held["version"]["sha256"] != before["version"]["sha256"]
        assert [c["use"] for c in held["version"]["campaigns"]] == ["train", "torques"]
        assert kilter.torques("holding", path).notes[0] == "Torques are by search by log."  # the active one holds none
        done = kilter.versions.activate(second)
        assert done["objections"] == []
        other = kilter.identify("holding", "log", effects=["load_friction"], name="later")
        assert other["version_id"] is None
        told = kilter.torques("holding", path)
        assert told.notes[0] == "Torques are by version by log."
        right = np.stack([kilter.torques("holding", path, search="by log").to_numpy()[f"tau{j}_nm"] for j in JOINTS])
        np.testing.assert_array_equal(np.stack([told.to_numpy()[f"tau{j}_nm"] for j in JOINTS]), right)
        with pytest.raises(ConflictError, match="holds no torques"):
            kilter.versions.export(first, "torque-c")
        source = tmp_path / "torque.c"
        source.write_bytes(kilter.versions.export(second, "torque-c"))
        command = ["cc", "-std=c99", "-Wall", "-Werror", "-shared", "-fPIC", "-o", str(tmp_path / "t.so"), str(source)]
        subprocess.run([*command, "-lm"], check=True)
        library = ctypes.CDLL(str(tmp_path / "t.so"))
        t = np.arange(8.0)
        vectors = [[name.format(j) for j in JOINTS] for name in ("q{}_deg", "qd{}_deg_s", "qdd{}_deg_s2")]
        fast = {"t_s": t} | {name: 20.0 * np.cos(t * k) for names in vectors for k, name in enumerate(names, 1)}
        by_path = kilter.torques("holding", fast).to_numpy()
        for k in range(8):
            motion = [np.radians([fast[name][k] for name in names]) for names in vectors]
            tau = np.empty(6)
            library.kt_torques(*(ctypes.c_void_p(one.ctypes.data) for one in (*motion, tau)))
            np.testing.assert_allclose(tau, [by_path[f"tau{j}_nm"][k] for j in JOINTS], rtol=1e-7, atol=1e-7)
        third = kilter.identify("holding", "poses", start=second, name="on")["version_id"]
        assert json.loads(kilter.versions.export(third, "json"))["calibration_si"]["torques"] == model
        line = "Torques of paths are told by search by log."
        assert line in kilter.versions.get(third)["headline"].splitlines()
        assert [one["torques"] for one in kilter.versions.list("holding")] == [True, True, False]
        assert kilter.robots.today("holding")["own"]["campaigns"][0]["name"] == "poses"
        with httpx.Client(base_url=kilter.url) as page:
            page.post("/login", data={"token": (server / "token").read_text().splitlines()[0]})
            text = page.get(f"/versions/{second}").raise_for_status().text
            assert "Torques of a path" in text
            for place in (
                f"versions/{second}/report",
                f"jobs/{kilter.versions.get(second)['job_id']}",
                "robots/holding",
            ):
                page.get(f"/{place}").raise_for_status()
    capsys.readouterr()
    out = tmp_path / "told.csv"
    given = tmp_path / "path.csv"
    np.savetxt(given, np.column_stack(list(path.values())), delimiter=",", header=",".join(path), comments="")
    assert run(["robot", "torque", "holding", str(given), "-o", str(out), "--version", "on"]) == 0
    assert "by version on" in capsys.readouterr().err
    assert run(["version", "list", "holding"]) == 0
    assert capsys.readouterr().out.count("; torques") == 2


def test_a_log_without_its_time_is_refused(server: Path, logged: Path, tmp_path: Path, capsys: Capture) -> None:
    table = np.genfromtxt(logged, delimiter=",", names=True)
    names = [name for name in table.dtype.names if name != "t_s"]
    bare = tmp_path / "bare.csv"
    np.savetxt(bare, np.column_stack([table[n] for n in names]), delimiter=",", header=",".join(names), comments="")
    assert run(["upload", "mover", str(bare), "--name", "bare"]) == 0
    assert run(["gap", "mover", "-c", "bare"]) != 0
    assert "no t_s" in capsys.readouterr().err


def test_a_log_is_identified_with_the_effects_that_somebody_chose(
    server: Path, logged: Path, hidden: tuple[Logger, Path], capsys: Capture
) -> None:
    with Kilter() as kilter:
        kilter.upload("mover", logged, name="fit")
        chosen = [{"id": "gear_ripple", "joints": [3]}, {"id": "load_friction", "joints": [2]}]
        found = kilter.identify("mover", "fit", effects=chosen, name="ripple")
        assert found["version_id"] is None
        (ripple,) = found["effects"]
        assert (ripple["id"], ripple["joints"], ripple["verdict"]) == ("gear_ripple", [3], "confirmed")
        assert [one["code"] for one in found["warnings"]] == ["effect_not_shown"]
        assert any(one["name"].startswith("load_friction") for one in found["motion"]["friction"])
        bare = kilter.identify("mover", "fit", level=1)
        (unused,) = bare["warnings"]
        assert unused["message"].startswith("level did nothing")
        assert bare["motion"]["joints"][2]["found"] > 2.0 * found["motion"]["joints"][2]["found"]
        assert bare["effects"] == []
        assert kilter.torques("mover", path_of(hidden[0]))
        (job,) = (one for one in kilter.jobs.list("mover") if one["name"] == "ripple")
        with httpx.Client(base_url=kilter.url) as page:
            page.post("/login", data={"token": (server / "token").read_text().splitlines()[0]})
            text = page.get(f"/jobs/{job['id']}").raise_for_status().text
        assert "Fit of these torques" in text
        assert "gear ripple of joint 3" in text
        only = kilter.gap("mover", "fit", effects=["load_friction"])
        assert only["effects"] == []
        with pytest.raises(JobFailedError, match="backlash is not an effect of torques"):
            kilter.identify("mover", "fit", effects=["backlash"])
    assert run(["identify", "mover", "-c", "fit", "--effects", "gear_ripple"]) == 0
    said = capsys.readouterr().out
    assert "Found: gear ripple of joint 3." in said
    assert "probable" not in said
    assert "Torque error of joint 3" in said


def path_of(logger: Logger) -> dict:
    t = np.arange(0.0, 2.0, 0.01)
    q, _, _ = logger._path(t)
    return {"t_s": t, **{f"q{j}_deg": np.degrees(q[:, j - 1]) for j in JOINTS}}


def test_what_is_carried_is_weighed(server: Path, logged: Path, hidden: tuple[Logger, Path], capsys: Capture) -> None:
    logger, _ = hidden
    body = Body(5, 1.8, np.array([0.02, 0.0, 0.05]), np.diag([0.004, 0.004, 0.002]))
    heavy = Logger(replace(logger.arm, bodies=(*logger.arm.bodies, body)), seed=7, extra=logger.extra)
    heavy.rng = np.random.default_rng(70)
    log = heavy.log()
    loaded = logged.with_name("loaded.csv")
    columns = np.column_stack([log["t"], np.degrees(log["q"]), log["tau"]])
    np.savetxt(loaded, columns, delimiter=",", header=",".join(HEAD), comments="", fmt="%.7g")
    assert run(["upload", "mover", str(logged), "--name", "without"]) == 0
    assert run(["upload", "mover", str(loaded), "--name", "with"]) == 0
    capsys.readouterr()
    asked = ["measure", "payload", "mover", "-c", "with", "-c", "without"]
    assert run(asked) == 0
    printed = capsys.readouterr().out
    assert re.match(r"It carries 1\.[78]\d? kg", printed)
    assert re.search(
        r"Next, with rows that carry it: kilter upload mover FILE --payload-kg 1\.[78]\d* --payload-com", printed
    )
    assert run(asked[:-2]) != 0
    assert "weighed by two campaigns" in capsys.readouterr().err
    assert run([*asked, "--empty", "other"]) != 0
    assert "not a campaign of this job" in capsys.readouterr().err
    # A search of both, which nobody told of the weight, names it, where it is and in which campaign.
    assert run(["gap", "mover", "-c", "without", "-c", "with"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"^Found: .*carried mass of joint 6 in with \(1\.[78]\d*(-1\.[89]\d*)? kg\)", printed)
    centre = ["--payload-com-mm", "20,0,50"]
    assert run(["upload", "mover", str(loaded), "--name", "stated", "--payload-kg", "1.8", *centre]) == 0
    capsys.readouterr()
    assert run(["gap", "mover", "-c", "without", "-c", "stated"]) == 0
    assert "carried mass" not in capsys.readouterr().out


def test_a_log_in_another_unit_with_smoothed_speeds_is_told_and_searched(
    server: Path, hidden: tuple[Logger, Path], logged: Path, capsys: Capture
) -> None:
    log = np.genfromtxt(logged, delimiter=",", names=True)
    table = {name: log[name] for name in HEAD} | {f"tau{j}_nm": 1000.0 * log[f"tau{j}_nm"] for j in JOINTS}
    late = {
        f"qd{j}_deg_s": np.roll(np.gradient(log[f"q{j}_deg"], 0.01), 15) for j in JOINTS
    }  # as a slow filter has them
    with Kilter() as kilter:
        kilter.upload("mover", table | late, name="N mm")
    assert run(["gap", "mover", "-c", "N mm"]) == 0
    printed = "".join(capsys.readouterr())
    assert printed.startswith("Found: gear ripple of joint 3")
    assert "Torques are 1000 times what the described masses need: joints 1, 2, 3, 4, 5, 6. Compare unit" in printed


def test_a_sensor_at_the_wrist_weighs_what_it_carries(server: Path, tmp_path: Path, capsys: Capture) -> None:
    wrist, names = Wrist(8, MOUNTING), ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")

    def table(rows: Observations) -> dict[str, Floats]:
        assert rows.wrench is not None
        read = {f"q{j}_deg": np.degrees(rows.q[:, j - 1]) for j in JOINTS} | dict(
            zip(names, rows.wrench.T, strict=True)
        )
        return read if rows.t is None else read | {"t_s": rows.t}

    poses, log = table(wrist.poses(30)), table(wrist.log(push=25.0))
    with Kilter() as kilter:
        kilter.robots.add(wrist.arm.document() | {"name": "felt"})
        kilter.upload("felt", poses, name="poses")
        kilter.upload("felt", log, name="log")
        kilter.upload("felt", log | {f"tau{j}_nm": np.sin(log["t_s"] + j) for j in JOINTS}, name="both")
        asked = {"sensor_mm": (1e3 * ORIGIN).tolist()}
        bodies = {c: kilter.jobs.run("payload", "felt", [c], options=asked)["result"] for c in ("poses", "log")}
    for one in bodies.values():
        assert abs(one["mass_kg"] - MASS) < one["mass_u95_kg"] * 2.0 < 0.04 * MASS
        assert np.linalg.norm(np.array(one["centre_mm"]) - 1e3 * CENTRE) < 5.0
        assert np.abs(np.array([*one["sensor"]["bias_n"], *one["sensor"]["bias_nm"]]) - BIAS).max() < 0.3
        assert one.get("joints") is None
    assert bodies["poses"].get("inertia_kg_m2") is None
    assert [one["code"] for one in bodies["log"]["warnings"]] == ["tool_touched"]
    out = tmp_path / "contact.csv"
    assert run(["measure", "payload", "felt", "-c", "log", "--sensor-mm", "[0,0,20]", "-o", str(out)]) == 0
    printed = capsys.readouterr()
    assert re.match(r"It carries 1\.[67]\d? kg", printed.out)
    assert "Bias of the sensor: 4" in printed.out
    rows = np.genfromtxt(out, delimiter=",", names=True)
    felt = (rows["t_s"] > 20.5) & (rows["t_s"] < 22.5)
    assert np.abs(rows["fz_n"][felt].mean() - 20.0) < 1.0 > np.abs(rows["fz_n"][rows["t_s"] < 19.0].mean())
    assert run(["measure", "payload", "felt", "-c", "both"]) != 0
    assert "Say which weighs" in capsys.readouterr().err
    assert run(["measure", "payload", "felt", "-c", "both", "--by", "wrench"]) == 0
    assert run(["measure", "payload", "felt", "-c", "log", "--empty", "poses"]) != 0
    assert "leave empty out" in capsys.readouterr().err
    for command in ("gap", "identify"):
        assert run([command, "felt", "-c", "log"]) != 0
        assert "no measured position" in capsys.readouterr().err


def test_motions_are_planned_for_a_recording(server: Path, logged: Path, tmp_path: Path, capsys: Capture) -> None:
    motions = tmp_path / "motions.csv"
    assert (
        run(["plan", "motion", "mover", "--seconds", "15", "--count", "2", "--speed-deg-s", "40", "-o", str(motions)])
        == 0
    )
    printed = capsys.readouterr()
    assert printed.out.startswith("2 motions in 33 s show 36 numbers of the bodies and the friction of 6 joints")
    assert "Collisions are not checked" in printed.out + printed.err
    table = np.genfromtxt(motions, delimiter=",", names=True)
    assert table.dtype.names == tuple(HEAD[:7])
    q = np.column_stack([table[name] for name in HEAD[1:7]])
    assert np.abs(np.gradient(q, table["t_s"], axis=0)).max() < 41.0
    program = tmp_path / "motions.src"
    assert run(["plan", "motion", "mover", "--seconds", "15", "--count", "1", "-o", str(program)]) == 0
    assert program.read_text().count("SPTP") > 100
    assert run(["plan", "motion", "mover", "-o", "motions.jbi"]) != 0
    assert ".src" in capsys.readouterr().err
    assert run(["plan", "motion", "mover", "--seconds", "3"]) != 0
    assert "12" in capsys.readouterr().err
