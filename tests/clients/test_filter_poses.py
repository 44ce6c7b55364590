"""`kilter filter` with poses: the controller's own nominal kinematics takes the real arm where the program was taught."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_client import Kilter
from kilter_client.cli import run

from .answered import document
from .six_joint_arms import Arm, Floats, about, apart, limits_deg, shift

ERRORS = {
    "theta_offset_2": 0.08,
    "theta_offset_3": -0.06,
    "theta_offset_5": 0.1,
    "a_2": 0.3,
    "alpha_1": 0.04,
    "beta_2": 0.03,
}
BASE = shift(120, -80, 45) @ about("ZYX", [0.3, -0.1, 0.2])
TOOL = shift(10, -20, 130) @ about("ZYX", [-0.4, 0.25, 0.1])
WITHIN_MM = 1e-6
LEAST_LEVERAGE = 9e-4


def calibrated(kilter: Kilter, preset: str, path: Path) -> str:
    """Add an arm and activate what exact measurements of one with errors identify."""
    name = f"poses-{preset}"
    kilter.robots.add({"name": name, "convention": "preset", "preset": preset})
    q = taught(preset, 30, seed=1)
    poses = np.array([Arm(preset, ERRORS).flange(one) for one in q])
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    head = [*(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"]
    rows = np.hstack([q, poses[:, :3, 3], turns])
    path.write_text("\n".join([",".join(head), *(",".join(f"{v:.15g}" for v in row) for row in rows), ""]))
    assert run(["upload", name, str(path), "--name", f"of-{preset}"]) == 0
    assert run(["identify", name, "-c", f"of-{preset}", "--level", "2", "--tool", "fixed", "--base", "fixed"]) == 0
    assert run(["activate", "latest", "--robot", name, "--force"]) == 0
    return name


def taught(preset: str, count: int, seed: int) -> Floats:
    """Joints away from singular postures, where a correction is not damped."""
    rng, bounds, arm = np.random.default_rng(seed), limits_deg(preset), Arm(preset)
    low, high = np.maximum(bounds[:, 0], -175), np.minimum(bounds[:, 1], 175)
    out: list[Floats] = []
    while len(out) < count:
        q = rng.uniform(low, high)
        J = [apart(arm.flange(q), arm.flange(q + step)) for step in np.eye(6) * 1e-3]
        if np.linalg.svd(np.array(J), compute_uv=False)[-1] > LEAST_LEVERAGE:
            out.append(q)
    return np.array(out)


def elbow(preset: str, q: Floats) -> float:
    """Bend of the elbow, deg: 0 where the arm is stretched."""
    a, d = {"irb120": (70, 302), "kr6-r900": (35, 420)}[preset]
    zero = -90.0 if preset == "irb120" else 0.0  # of the third joint where the forearm continues the upper arm
    return float(q[2] - zero - np.degrees(np.arctan2(a, d)))


def zyx(T: Floats) -> Floats:
    return np.array([*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_euler("ZYX", degrees=True)])


def of_zyx(six: Floats) -> Floats:
    return shift(*six[:3]) @ about("ZYX", np.radians(six[3:]))


class Language(NamedTuple):
    """How a language writes poses, what states its posture, and how both are read back."""

    preset: str
    ending: str
    options: list[str]
    program: Callable[[Floats, Floats], str]
    back: Callable[[str], list[tuple[Floats, str]]]
    states: Callable[[Floats], str]


def status_turn(q: Floats) -> str:
    arm = Arm("kr6-r900")
    behind = arm.wrist(np.array([0, *q[1:]]))[0] < 0
    up = elbow("kr6-r900", q) > 0
    bits = sum(1 << k for k in range(6) if q[k] < 0)
    return f"S {behind * 1 + up * 2 + (q[4] > 0) * 4},T {bits}"


def krl(q: Floats, poses: Floats) -> str:
    six = [",".join(f"{n} {v:.9f}" for n, v in zip("XYZABC", zyx(T), strict=True)) for T in poses]
    frames = ",".join(f"{n} {v:.9f}" for n, v in zip("XYZABC", zyx(BASE), strict=True))
    tool = ",".join(f"{n} {v:.9f}" for n, v in zip("XYZABC", zyx(TOOL), strict=True))
    moves = [f"PTP {{{one},{status_turn(at)},E1 0.0}} C_PTP ; {{X 1}}" for one, at in zip(six, q, strict=True)]
    return "\r\n".join(["DEF w()", f"$BASE={{{frames}}}", f"$TOOL={{{tool}}}", "$VEL.CP=0.2", *moves, "END", ""])


def krl_back(text: str) -> list[tuple[Floats, str]]:
    lines = [line for line in text.splitlines() if line.startswith("PTP")]
    return [
        (of_zyx(np.array([float(v) for v in re.findall(r"[XYZABC] (-?[\d.]+)", line.partition(";")[0])])),
         re.findall(r"S \d+,T \d+", line)[0])
        for line in lines
    ]  # fmt: skip


def quaternion(T: Floats) -> str:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return f"[{','.join(f'{v:.9f}' for v in T[:3, 3])}],[{','.join(f'{v:.12f}' for v in (w, x, y, z))}]"


def confdata(q: Floats) -> str:
    behind = Arm("irb120").wrist(np.array([0, *q[1:]]))[0] < 0
    down = elbow("irb120", q) < 0
    quadrants = [int(np.floor(q[k] / 90)) for k in (0, 3, 5)]
    return f"[{','.join(map(str, quadrants))},{behind * 4 + down * 2 + (q[4] < 0)}]"


def rapid(q: Floats, poses: Floats) -> str:
    targets = [
        f"  CONST robtarget p{k} := [{quaternion(T)},{confdata(at)},[9E9,9E9,9E9,9E9,9E9,9E9]];"
        for k, (T, at) in enumerate(zip(poses, q, strict=True))
    ]
    frames = [
        f"  PERS tooldata grip := [TRUE,[{quaternion(TOOL)}],[1,[0,0,1],[1,0,0,0],0,0,0]];",
        f'  PERS wobjdata bench := [FALSE,TRUE,"",[{quaternion(shift(0, 0, 7))}],[{quaternion(shift(0, 0, -7) @ BASE)}]];',
    ]
    moves = [f"  MoveL p{k}, v100\\V:=80, z10, grip\\WObj:=bench;" for k in range(len(q))]
    return "\n".join(["MODULE w", *targets, *frames, "PROC main()", *moves, "ENDPROC", "ENDMODULE", ""])


def rapid_back(text: str) -> list[tuple[Floats, str]]:
    found = []
    for line in text.splitlines():
        if "robtarget" in line:
            v = [float(part) for part in re.findall(r"-?[\d.]+(?:E\d)?", line.partition(":=")[2])]
            T = shift(*v[:3])
            T[:3, :3] = Rotation.from_quat([*v[4:7], v[3]]).as_matrix()
            found.append((T, "[" + ",".join(str(int(c)) for c in v[7:11]) + "]"))
    return found


def config(q: Floats) -> str:
    behind = Arm("irb120").wrist(np.array([0, *q[1:]]))[0] < 0
    turns = [int(np.floor((q[k] + 180) / 360)) for k in (0, 3, 5)]
    letters = f"{'N' if q[4] < 0 else 'F'} {'U' if elbow('irb120', q) > 0 else 'D'} {'B' if behind else 'T'}"
    return f"'{letters}, {', '.join(map(str, turns))}'"


def fanuc(q: Floats, poses: Floats) -> str:
    positions = []
    for k, (T, at) in enumerate(zip(poses, q, strict=True), 1):
        x, y, z, r, p, w = zyx(T)
        places = ", ".join(f"{n} = {v:.9f} mm" for n, v in zip("XYZ", (x, y, z), strict=True))
        turns = ", ".join(f"{n} = {v:.10f} deg" for n, v in zip("WPR", (w, p, r), strict=True))
        positions.append(f"P[{k}]{{\n   GP1:\n\tUF : 2, UT : 1,\tCONFIG : {config(at)},\n\t{places},\n\t{turns}\n}};")
    moves = [f"  {k}:L P[{k}] 100mm/sec FINE    ;" for k in range(1, len(q) + 1)]
    return "\n".join(["/PROG W", "/MN", *moves, "/POS", *positions, "/END", ""])


def fanuc_back(text: str) -> list[tuple[Floats, str]]:
    found = []
    for block in re.findall(r"P\[\d+\]\{(.*?)\};", text, re.S):
        x, y, z, w, p, r = (float(v) for v in re.findall(r"\b[XYZWPR] = (-?[\d.]+)", block))
        found.append((of_zyx(np.array([x, y, z, r, p, w])), re.findall(r"'.*'", block)[0]))
    return found


def numbers(T: Floats, swap: bool = False) -> str:
    six = zyx(T)
    return ",".join(f"{v:.12f}" for v in (six[[0, 1, 2, 5, 4, 3]] if swap else six))


def vector(T: Floats) -> str:
    return ", ".join(f"{v:.14f}" for v in (*T[:3, 3] / 1e3, *Rotation.from_matrix(T[:3, :3]).as_rotvec()))


def urscript(q: Floats, poses: Floats) -> str:
    lines = ["def w():", f"  set_tcp(p[{vector(TOOL)}])"]
    for k, (T, at) in enumerate(zip(poses, q, strict=True)):
        near = at + np.random.default_rng(k).uniform(-4, 4, 6)
        lines += [
            f"  movej([{', '.join(f'{v:.9f}' for v in np.radians(near))}], a=1.4)",
            f"  movel(p[{vector(T)}], a=1.2, v=0.2)",
        ]
    return "\n".join([*lines, "end", ""])


def urscript_back(text: str) -> list[tuple[Floats, str]]:
    found = []
    for inside in re.findall(r"movel\(p\[(.*?)\]", text):
        v = np.array([float(part) for part in inside.split(",")])
        T = shift(*v[:3] * 1e3)
        T[:3, :3] = Rotation.from_rotvec(v[3:]).as_matrix()
        found.append((T, ""))
    return found


LANGUAGES = {
    "KRL": Language("kr6-r900", ".src", [], krl, krl_back, status_turn),
    "RAPID": Language("irb120", ".mod", [], rapid, rapid_back, confdata),
    "FANUC LS": Language(
        "irb120", ".ls", ["--fanuc-j3", "same", "--base", f"2={numbers(BASE, True)}", "--tool", f"1={numbers(TOOL, True)}"],
        fanuc, fanuc_back, config,
    ),
    "URScript": Language("ur10e", ".script", [], urscript, urscript_back, lambda q: ""),
}  # fmt: skip


@pytest.fixture(scope="module")
def arms() -> dict[str, str]:
    return {}


def robot_of(kilter: Kilter, arms: dict[str, str], preset: str, folder: Path) -> str:
    if preset not in arms:
        arms[preset] = calibrated(kilter, preset, folder / "measured.csv")
    return arms[preset]


@pytest.mark.parametrize("name", [*LANGUAGES])
def test_nominal_controller_and_corrected_program_hit_the_taught_points(
    kilter: Kilter, arms: dict[str, str], tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    one = LANGUAGES[name]
    robot = robot_of(kilter, arms, one.preset, tmp_path)
    q = taught(one.preset, 40, seed=5)
    ideal, real = Arm(one.preset), Arm(one.preset, ERRORS)
    base = np.eye(4) if name == "URScript" else BASE
    wanted = np.array([ideal.flange(at) @ TOOL for at in q])
    path, output = tmp_path / f"w{one.ending}", tmp_path / f"out{one.ending}"
    path.write_bytes(one.program(q, np.linalg.inv(base) @ wanted).encode())
    capsys.readouterr()
    told = document(capsys, "filter", path, "--robot", robot, "-o", output, *one.options)
    assert told["left"] == []
    assert told["targets"] == len(q) * (2 if name == "URScript" else 1)
    assert told["not_ok"] == []
    back = one.back(output.read_text())
    assert len(back) == len(q)
    before, after = [], []
    for k, ((pose, stated), at) in enumerate(zip(back, q, strict=True)):
        command = ideal.joints(base @ pose @ np.linalg.inv(TOOL), at)  # as the controller's nominal kinematics has them
        assert stated == one.states(command)
        before.append(np.linalg.norm((real.flange(at) @ TOOL - wanted[k])[:3, 3]))
        after.append(np.linalg.norm((real.flange(command) @ TOOL - wanted[k])[:3, 3]))
    assert min(before) > 0.05
    assert max(after) < WITHIN_MM
    old, corrected = path.read_text().splitlines(), output.read_text().splitlines()
    new = [line for line in corrected if "Kilter corrected ver_" not in line]
    assert len(corrected) == len(new) + 1
    number = re.compile(r"-?\d[\d.]*")
    assert [number.sub("#", line) for line in old] == [number.sub("#", line) for line in new]


@pytest.mark.parametrize("order", ["ABA", "ABCBA", "ABAB", "ABBA"])
def test_a_path_that_comes_back_to_a_pose_is_rewritten(
    kilter: Kilter, arms: dict[str, str], tmp_path: Path, order: str, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = robot_of(kilter, arms, "ur10e", tmp_path)
    ideal, real = Arm("ur10e"), Arm("ur10e", ERRORS)
    at = {
        "A": [-91.0, -98, -126, -46, 91, -2],
        "B": [-92.0, -88, -117, -66, 91, -2],
        "C": [-85.0, -80, -120, -60, 88, 5],
    }
    pose = {name: ideal.flange(np.array(q)) @ TOOL for name, q in at.items()}
    listed = [f"  {name}=p[{vector(T)}]" for name, T in pose.items() if name in order]
    start = ", ".join(f"{v:.9f}" for v in np.radians(at["A"]))
    lines = ["def w():", f"  set_tcp(p[{vector(TOOL)}])", *listed, f"  movej([{start}], a=1.4)"]
    path, output = tmp_path / "w.script", tmp_path / "out.script"
    path.write_text("\n".join([*lines, *(f"  movel({name})" for name in order), "end", ""]))
    told = document(capsys, "filter", path, "--robot", robot, "-o", output)
    assert told["left"] == []
    written = re.findall(r"^  (\w)=p\[(.*)\]", output.read_text(), re.M)
    assert len(written) == len(listed)
    for name, inside in written:
        v = np.array([float(part) for part in inside.split(",")])
        T = shift(*v[:3] * 1e3)
        T[:3, :3] = Rotation.from_rotvec(v[3:]).as_matrix()
        command = ideal.joints(T @ np.linalg.inv(TOOL), np.array(at[name]))
        assert np.linalg.norm((real.flange(command) @ TOOL - pose[name])[:3, 3]) < WITHIN_MM


def lines_left(told: dict[str, object]) -> dict[int, str]:
    left = told["left"]
    assert isinstance(left, list)
    return {one["line"]: one["what"] for one in left}


KRL_LINES = """DEF w()
LIN {X 1,Y 2,Z 3,A 4,B 5,C 6,S 2,T 2}
$TOOL=TOOL_DATA[1]
$BASE=BASE_DATA[2]
PTP {GOOD}
CIRC {NEXT},{GOOD}
LIN_REL {X 10}
LIN {NEXT}
PTP {WRONG}
PTP {X 9000,Y 0,Z 0,A 0,B 0,C 0,S 2,T 2}
LIN XP1:{Z 50}
CIRC {NEXT},{GOOD}
IF $IN[1] THEN
$TOOL=TOOL_DATA[3]
ENDIF
PTP {GOOD}
PTP {A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}
END
"""
LEFT = {
    2: "its base is not set before it", 7: "a relative move", 8: "the target from which the arm comes is not known",
    9: "no joints within their limits have its configuration", 10: "it is out of reach", 11: "not a target of this file",
    12: "the target from which the arm comes is not known",
    16: "its tool depends on the way",
}  # fmt: skip


def test_what_is_not_known_of_a_pose_is_named_with_its_line(
    kilter: Kilter, arms: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = robot_of(kilter, arms, "kr6-r900", tmp_path)
    q = np.array([10.0, -80, 75, 20, 40, 30])
    ideal = Arm("kr6-r900")
    six = [",".join(f"{n} {v:.9f}" for n, v in zip("XYZABC", zyx(ideal.flange(at)), strict=True)) for at in (q, q + 3)]
    words = {"GOOD": f"{six[0]},{status_turn(q)}", "NEXT": six[1], "WRONG": f"{six[0]},S 2,T 63"}
    text = KRL_LINES
    for word, pose in words.items():
        text = text.replace(word, pose)
    path, output = tmp_path / "w.src", tmp_path / "out.src"
    path.write_text(text)
    capsys.readouterr()
    frames = ["--base", "2=0,0,0,0,0,0", "--tool", "1=0,0,0,0,0,0", "--tool", "3=0,0,9,0,0,0"]
    told = document(capsys, "filter", path, "--robot", robot, "-o", output, *frames)
    assert lines_left(told).keys() == LEFT.keys()
    for line, said in LEFT.items():
        assert said in lines_left(told)[line]
    written = output.read_text().split("\n")
    assert written.pop(-3).startswith(";Kilter corrected ver_")
    changed = [k for k, (a, b) in enumerate(zip(text.split("\n"), written, strict=True), 1) if a != b]
    assert changed == [5, 6, 12, 17]
    refused = document(capsys, "filter", path, "--robot", robot, "-o", tmp_path / "no.src", "--strict", code=1)
    assert refused["code"] == "file_invalid"
    assert not (tmp_path / "no.src").exists()
    assert run(["filter", str(path), "--robot", robot, "--diff", "--base", "2=1,2"]) == 2
    assert run(["filter", str(path), "--robot", robot, "--diff", "--base", "2=0,0,0,1,0,0,0"]) == 2
    assert "a frame of KRL has 6 numbers, not 7" in capsys.readouterr().err
    undefined = document(capsys, "filter", path, "--robot", robot, "-o", output)
    assert "state it, --base 2=X,Y,Z,A,B,C" in lines_left(undefined)[5]


def test_a_joint_that_the_correction_takes_through_zero_gets_another_turn(
    kilter: Kilter, arms: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = robot_of(kilter, arms, "kr6-r900", tmp_path)
    ideal = Arm("kr6-r900")
    path, output = tmp_path / "w.src", tmp_path / "out.src"
    for k in (0, 3, 5):
        turns = set()
        for small in (0.001, -0.001):
            q = np.array([10.0, -80, 75, 20, 40, 30])
            q[k] = small
            path.write_text(krl(q[None], np.linalg.inv(BASE) @ ideal.flange(q)[None] @ TOOL))
            capsys.readouterr()
            told = document(capsys, "filter", path, "--robot", robot, "-o", output)
            assert told["left"] == []
            pose, stated = krl_back(output.read_text())[0]
            command = ideal.joints(BASE @ pose @ np.linalg.inv(TOOL), q)
            assert stated == status_turn(command)
            turns.add((status_turn(q), stated))
        assert len({stated for _, stated in turns}) == 1
        assert any(before != after for before, after in turns)


@pytest.mark.parametrize("name", ["RAPID", "FANUC LS"])
def test_no_pose_is_written_whose_posture_is_no_longer_the_stated_one(
    kilter: Kilter, arms: dict[str, str], tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Joint 5 so near zero that its error takes it to the other side: the controller would spin the wrist by half a turn."""
    one = LANGUAGES[name]
    robot = robot_of(kilter, arms, one.preset, tmp_path)
    ideal = Arm(one.preset)
    q = np.array([[10.0, 20, 15, 30, small, 25] for small in BENDS])
    path, output = tmp_path / f"w{one.ending}", tmp_path / f"out{one.ending}"
    poses = np.linalg.inv(BASE) @ np.array([ideal.flange(at) @ TOOL for at in q])
    path.write_text(one.program(q, poses))
    capsys.readouterr()
    told = document(capsys, "filter", path, "--robot", robot, "-o", output, *one.options)
    before, after = (one.back(file.read_text()) for file in (path, output))
    kept = 0
    for (old, _), (new, stated), at in zip(before, after, q, strict=True):
        if np.array_equal(old, new):
            continue
        kept += 1
        command = ideal.joints(BASE @ new @ np.linalg.inv(TOOL), at)
        over = command + np.array([0, 0, 0, 180, -2 * command[4], 180])  # the other bend of the wrist
        meant = min(command, over, key=lambda c: abs(np.remainder(c[3] - at[3] + 180, 360) - 180))
        assert one.states(meant)[AXIS_5[name]] == stated[AXIS_5[name]], (at, meant, stated)
    named = {line["line"] for line in told["left"] if "singularity" in line["what"]}
    assert kept + len(named) == len(q)


AXIS_5 = {"RAPID": -2, "FANUC LS": 1}  # the character that says on which side axis 5 is


BENDS = (-20.0, -0.3, -0.12, -0.05, -0.01, 0.01, 0.05, 0.12, 0.3, 20.0)


def offset_wrist(name: str) -> dict[str, object]:
    """A small arm of which axes 4, 5 and 6 do not meet: the flange stands 150 mm beside axis 4."""
    return {
        "name": name, "convention": "dh", "joints": [{"name": f"J{k}", "limits_deg": [-170, 170]} for k in range(1, 7)],
        "rows": [
            {"type": "revolute", "theta_offset_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
            for theta, d, a, alpha in OFFSET_WRIST
        ],
    }  # fmt: skip


OFFSET_WRIST = [(0, 245, 0, -90), (-90, 0, 540, 0), (0, 0, 0, -90), (0, 540, 0, 90), (0, 150, 0, -90), (0, 160, 0, 0)]
SEVEN_AXES = [
    (0, 360, 0, -90), (0, 0, 0, 90), (0, 420, 0, 90), (0, 0, 0, -90), (0, 400, 0, -90), (0, 0, 0, 90), (0, 126, 0, 0),
]  # fmt: skip


def of_rows(rows: list[tuple[float, ...]], q: Floats) -> Floats:
    """Flange (4, 4) mm of an arm by its table."""
    T = np.eye(4)
    for (theta, d, a, alpha), value in zip(rows, q, strict=True):
        T = T @ about("z", np.radians(theta + value)) @ shift(a, 0, d) @ about("x", np.radians(alpha))
    return T


def corrected(
    kilter: Kilter, folder: Path, robot: str, document: dict[str, object], rows: list[tuple[float, ...]]
) -> tuple[list[tuple[float, ...]], Floats]:
    """Calibrate an arm that stands a little beside its table: the real one, and the joints (N, n) deg it was measured at."""
    count = len(rows)
    kilter.robots.add(document)
    rng = np.random.default_rng(11)
    real = [(theta + error, *rest) for (theta, *rest), error in zip(rows, rng.uniform(-0.1, 0.1, count), strict=True)]
    q = rng.uniform(-80, 80, (40, count))
    seen = np.array([of_rows(real, at) for at in q])
    turns = Rotation.from_matrix(seen[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    head = ",".join([*(f"q{k}_deg" for k in range(1, count + 1)), "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"])
    body = [",".join(f"{v:.15g}" for v in row) for row in np.hstack([q, seen[:, :3, 3], turns])]
    (folder / "seen.csv").write_text("\n".join([head, *body, ""]))
    assert run(["upload", robot, str(folder / "seen.csv"), "--name", f"of-{robot}"]) == 0
    assert run(["identify", robot, "-c", f"of-{robot}", "--level", "2", "--tool", "fixed", "--base", "fixed"]) == 0
    assert run(["activate", "latest", "--robot", robot, "--force"]) == 0
    return real, q


NULLS = ["$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}", "$TOOL={X 0,Y 0,Z 0,A 0,B 0,C 0}"]


def krl_joints(at: Floats) -> str:
    return f"PTP {{{','.join(f'A{k} {v:.9f}' for k, v in enumerate(at, 1))}}}"


def krl_pose(T: Floats) -> str:
    return "LIN {" + ",".join(f"{n} {v:.9f}" for n, v in zip("XYZABC", zyx(T), strict=True)) + "}"


def joints_near(rows: list[tuple[float, ...]], T: Floats, start: Floats) -> Floats:
    """Joints (n,) deg of a table's arm at a pose: the controller's own inverse, by steps from joints nearby."""
    q = start.copy()
    for _ in range(30):
        J = np.empty((6, 6))
        at = of_rows(rows, q)
        for k in range(6):
            moved = of_rows(rows, q + 1e-4 * np.eye(6)[k]) @ np.linalg.inv(at)
            J[:, k] = [*(moved[:3, 3]), moved[2, 1], moved[0, 2], moved[1, 0]]
        off = T @ np.linalg.inv(at)
        q = q + 1e-4 * np.linalg.solve(J, [*off[:3, 3], off[2, 1], off[0, 2], off[1, 0]])
    return q


def test_poses_of_an_arm_without_a_closed_inverse_are_corrected(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each after joints nearby, which say what posture is meant: of up to 16, whose branches have no names."""
    robot = "offset-wrist"
    real, q = corrected(kilter, tmp_path, robot, offset_wrist(robot), OFFSET_WRIST)
    taught_at = q[:6]
    poses = [of_rows(OFFSET_WRIST, at + 2.0) for at in taught_at]
    lines = [line for at, T in zip(taught_at, poses, strict=True) for line in (krl_joints(at), krl_pose(T))]
    path, output = tmp_path / "w.src", tmp_path / "out.src"
    path.write_text("\n".join(["DEF w()", *NULLS, *lines, "END", ""]))
    capsys.readouterr()
    told = document(capsys, "filter", path, "--robot", robot, "-o", output)
    held = {one["line"] for one in told["not_ok"]} | lines_left(told).keys()
    new = output.read_text().splitlines()
    off, before = [], []
    for k, (at, T) in enumerate(zip(taught_at, poses, strict=True)):
        if 5 + 2 * k in held:
            continue
        posed = of_zyx(np.array([float(v) for v in re.findall(r"[XYZABC] (-?[\d.]+)", new[4 + 2 * k])]))
        command = joints_near(OFFSET_WRIST, posed, at + 2.0)
        assert np.abs(command - at - 2.0).max() < 2.0
        off.append(np.linalg.norm((of_rows(real, command) - T)[:3, 3]))
        before.append(np.linalg.norm((of_rows(real, at + 2.0) - T)[:3, 3]))
    assert len(off) >= 5, told
    assert min(before) > 0.1
    assert max(off) < WITHIN_MM


def test_an_arm_of_seven_axes_gets_joints_exactly_and_its_poses_are_named(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, robot = SEVEN_AXES, "seven-axes"
    arm = {"name": robot, "convention": "preset", "preset": "iiwa14"}
    real, q = corrected(kilter, tmp_path, robot, arm, rows)
    taught_at = q[:8]
    joints, pose = [krl_joints(at) for at in taught_at], krl_pose(of_rows(rows, q[0]))
    path, output = tmp_path / "w.src", tmp_path / "out.src"
    path.write_text("\n".join(["DEF w()", *NULLS, *joints, pose, "END", ""]))
    capsys.readouterr()
    told = document(capsys, "filter", path, "--robot", robot, "-o", output)
    line = len(joints) + 4
    assert "has 7 joints" in lines_left(told)[line]
    assert "Give joint targets" in lines_left(told)[line]
    assert lines_left(told).keys() == {line}
    assert told["targets"] == len(joints)
    new = output.read_text().splitlines()
    assert new[line - 1] == pose
    held = {one["line"] for one in told["not_ok"]}
    off = []
    for number, (at, text) in enumerate(zip(taught_at, new[3:], strict=False), 4):
        command = np.array([float(v) for v in re.findall(r"A\d (-?[\d.]+)", text)])
        assert np.abs(command - at).max() < 2.0  # beside the programmed posture, not in another
        if number not in held:
            off.append(np.linalg.norm((of_rows(real, command) - of_rows(rows, at))[:3, 3]))
    assert len(off) > len(joints) / 2
    assert max(off) < WITHIN_MM
