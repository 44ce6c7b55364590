"""Joint logs of controllers: bags as the rosbags library writes them, and programs of four makers."""

from __future__ import annotations

import json
import math
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from kilter_client import FileError, prepare
from kilter_client.cli import run
from kilter_files.formats.joints.bag import read_bag
from kilter_files.formats.joints.joint_log import read_joint_log
from kilter_files.formats.programs.dialects import DIALECTS
from kilter_files.formats.programs.found import Dialect, Program
from kilter_files.formats.programs.marks import read_targets
from kilter_files.formats.programs.reading import read_program
from kilter_files.formats.reader import LogHints
from kilter_files.look.drafts import inspect
from tests.clients.answered import document
from tests.clients.files.simulated import arm, wander, write_n3d
from tests.clients.files.test_fuzz import EDITS, edited

STORE = get_typestore(Stores.ROS2_HUMBLE)
STATE = "sensor_msgs/msg/JointState"
ARM = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")


def write_bag(
    folder: Path, messages: list[tuple[str, float, dict[str, float]]], storage: str = "mcap", packed: str = "",
    stamped: bool = True, behind_s: Sequence[float] = (),
) -> Path:  # fmt: skip
    """Write messages (topic, time, position by joint), stamped ``behind_s`` earlier, and return the bag's folder."""
    kinds = STORE.types
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if packed:
        writer.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    with writer:
        topics = {
            topic: writer.add_connection(topic, STATE, typestore=STORE) for topic in sorted({m[0] for m in messages})
        }
        for k, (topic, t, joints) in enumerate(messages):
            ns = 1_700_000_000_000_000_000 + round(t * 1e9)
            sent = ns - round(behind_s[k] * 1e9) if behind_s else ns
            stamp = kinds["builtin_interfaces/msg/Time"](*(divmod(sent, 10**9) if stamped else (0, 0)))
            header = kinds["std_msgs/msg/Header"](stamp, "")
            state = kinds[STATE](header, list(joints), np.array(list(joints.values())), np.zeros(0), np.zeros(0))
            writer.write(topics[topic], ns, STORE.serialize_cdr(state, STATE))
    return folder


def by_alphabet(q_deg: np.ndarray, t: np.ndarray) -> list[tuple[str, float, dict[str, float]]]:
    """Messages as joint_state_broadcaster writes them: the elbow first."""
    rows = np.radians(q_deg)
    return [
        ("/joint_states", float(a), {n: float(v) for n, v in sorted(zip(ARM, row, strict=True))})
        for a, row in zip(t, rows, strict=True)
    ]


@pytest.mark.parametrize("storage", ["mcap", "db3"])
@pytest.mark.parametrize("named", ["folder", "file", "metadata.yaml"])
def test_a_bag_in_the_order_of_the_arm(tmp_path: Path, storage: str, named: str) -> None:
    t = np.arange(50) / 100
    folder = write_bag(tmp_path / "bag", by_alphabet(wander(t), t), storage)
    file = next(folder.glob(f"*.{storage}"))
    path = {"folder": folder, "file": file, "metadata.yaml": folder / "metadata.yaml"}[named]
    log = read_joint_log(path, hints=LogHints(order=ARM))
    assert log.joints == ("q1_rad", "q2_rad", "q3_rad")
    np.testing.assert_allclose(log.q(), np.radians(wander(t)), atol=1e-12)
    np.testing.assert_allclose(log.t_s, t, atol=1e-9)
    assert "q1 to q3 are shoulder_pan_joint, shoulder_lift_joint, elbow_joint" in log.notes


def test_the_order_is_known_of_numbers_and_of_the_makers_names_else_asked_for(tmp_path: Path) -> None:
    def names(joints: dict[str, float], folder: str) -> Path:
        return write_bag(tmp_path / folder, [("/js", 0.0, joints), ("/js", 0.1, joints)])

    ur = {"elbow_joint": 3.0, "shoulder_lift_joint": 2.0, "shoulder_pan_joint": 1.0, "wrist_1_joint": 4.0,
          "wrist_2_joint": 5.0, "wrist_3_joint": 6.0}  # fmt: skip
    assert read_joint_log(names(ur, "a")).q()[0].tolist() == [1, 2, 3, 4, 5, 6]
    numbered = {"j2": 2.0, "j10": 10.0, "j1": 1.0}
    assert read_joint_log(names(numbered, "b")).q()[0].tolist() == [1, 2, 10]
    other = names({"elbow": 2.0, "base": 1.0}, "c")
    with pytest.raises(FileError, match=r"which of its joints is the first \(elbow, base\).*--joint-order"):
        read_joint_log(other)
    with pytest.raises(FileError, match=r"no joint|no message of /js holds bse"):
        read_joint_log(other, hints=LogHints(order=("bse",)))
    slid = read_joint_log(other, hints=LogHints(order=("base:m", "elbow")))
    assert (slid.joints, slid.q()[0].tolist()) == (("q1_m", "q2_rad"), [1.0, 2.0])
    assert read_joint_log(other, hints=LogHints(likely=("base", "elbow"))).q()[0].tolist() == [1, 2]


def test_a_gripper_on_the_same_topic_and_repeated_messages(tmp_path: Path) -> None:
    messages = []
    for k in range(30):
        messages += [("/js", k / 10, {"j1": k / 100, "j2": 0.0}), ("/js", k / 10, {"j1": k / 100, "j2": 0.0})]
        messages += [("/js", k / 10 + 0.01, {"finger": 0.1})]
    path = write_bag(tmp_path / "bag", messages)
    with pytest.raises(FileError, match=r"message 3: its messages hold different joints \(j1, j2; here finger\)"):
        read_joint_log(path)
    log = read_joint_log(path, hints=LogHints(order=("j1", "j2")))
    assert len(log) == 30
    assert any("30 messages left out: they do not hold j1, j2" in text for text in log.warnings)
    assert any("30 messages left out: they repeat" in text for text in log.warnings)


def test_messages_of_one_stamp_are_averaged_and_counted(tmp_path: Path) -> None:
    stamps = [0.0, 0.1, 0.1, 0.2, 0.3, 0.3, 0.3, 0.4, 0.4]
    q = [0.0, 0.01, 0.02, 0.02, 0.03, 0.04, 0.05, 0.05, 0.05]
    path = write_bag(tmp_path / "bag", [("/js", t, {"j1": a, "j2": 0.0}) for t, a in zip(stamps, q, strict=True)])
    log = read_joint_log(path)
    np.testing.assert_allclose(log.t_s, [0, 0.1, 0.2, 0.3, 0.4], atol=1e-9)
    np.testing.assert_allclose(log.q()[:, 0], [0, 0.015, 0.02, 0.04, 0.05], atol=1e-12)
    assert any("3 messages merged: their stamp is that of the one before" in text for text in log.warnings)
    assert any("1 messages left out: they repeat" in text for text in log.warnings)


def test_a_clock_that_goes_back_is_refused(tmp_path: Path) -> None:
    rows = [("/js", k / 10, {"j1": k / 100}) for k in range(6)]
    path = write_bag(tmp_path / "bag", rows, behind_s=[0, 0, 0, 5, 5, 5])
    with pytest.raises(FileError, match=r"message 4: its clock goes back: two recordings, or two publishers. Split"):
        read_joint_log(path)


def test_inspect_takes_the_order_that_its_refusal_asks_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [("/js", k / 10, {"b": k / 100, "a": 0.0} if k % 2 else {"finger": 0.1}) for k in range(1, 30)]
    path = write_bag(tmp_path / "bag", rows)
    assert run(["inspect", str(path)]) == 1
    assert "(--joint-order a,b,c)" in capsys.readouterr().err
    found = document(capsys, "inspect", path, "--joint-order", "a,b")
    assert (found["kind"], found["rows"]) == ("joint-log", 15)
    assert [c["name"] for c in found["columns"]][:2] == ["q1_rad", "q2_rad"]


def test_without_stamps_the_time_of_writing_counts(tmp_path: Path) -> None:
    t = np.arange(20) / 50
    path = write_bag(tmp_path / "bag", by_alphabet(wander(t), t), "db3", stamped=False)
    np.testing.assert_allclose(read_joint_log(path, hints=LogHints(order=ARM)).t_s, t, atol=1e-9)


@pytest.mark.parametrize(
    ("messages", "hints", "words"),
    [
        ([("/a", 0.0, {"j1": 1.0}), ("/b", 0.0, {"j1": 1.0})], LogHints(), "joint states come from /a, /b. Choose one"),
        ([("/a", 0.0, {"j1": 1.0})], LogHints("/c"), "no topic '/c' .* Those with joint states are /a"),
        ([("/a", 0.1, {"j1": 1.0}), ("/a", 0.1, {"j1": 2.0})], LogHints(), "message 2: 2 messages have one stamp .* 1 rad"),
        ([("/a", 0.1, {"j1": k / 20}) for k in range(4)], LogHints(), "message 2: 4 messages have one stamp .* 0.15 rad"),
        ([("/a", 0.0, {"j1": 1.0}), ("/a", 0.1, {"j1": float("nan")})], LogHints(), "message 2: the position of 'j1' is no"),
        ([("/a", 0.0, {"j1": 1.0}), ("/a", 0.1, {"j1": 90.0})], LogHints(), "message 2, column 'q1_rad': 90 rad is more"),
        ([("/a", 0.0, {})], LogHints(), "no message of /a holds a joint"),
    ],
)  # fmt: skip
def test_bags_that_are_refused(tmp_path: Path, messages: list[Any], hints: LogHints, words: str) -> None:
    with pytest.raises(FileError, match=words):
        read_joint_log(write_bag(tmp_path / "bag", messages, "db3"), hints=hints)


def test_damaged_bags(tmp_path: Path) -> None:
    t = np.arange(500) / 100
    for storage, words in (("mcap", "is cut off"), ("db3", "is cut off: it states")):
        file = next(write_bag(tmp_path / storage, by_alphabet(wander(t), t), storage).glob(f"*.{storage}"))
        whole = file.read_bytes()
        alone = tmp_path / f"alone.{storage}"
        alone.write_bytes(whole[: len(whole) * 2 // 3])
        with pytest.raises(FileError, match=words):
            read_bag(alone)
        alone.write_bytes(whole + whole)
        if storage == "mcap":
            with pytest.raises(FileError, match="goes on behind its end"):
                read_bag(alone)
    packed = write_bag(tmp_path / "packed", by_alphabet(wander(t), t), "db3", "MESSAGE")
    with pytest.raises(FileError, match=r"is packed by its messages. Or write it again with `ros2 bag convert`"):
        read_bag(packed)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match=r"a folder without metadata.yaml: no bag"):
        read_bag(tmp_path / "empty")


def test_a_chunk_that_claims_ten_gigabytes_or_is_a_bomb(tmp_path: Path) -> None:
    from backports import zstd

    file = next(write_bag(tmp_path / "bag", [("/a", 0.0, {"j1": 1.0})]).glob("*.mcap"))
    content = bytearray(file.read_bytes())
    at = 8
    while content[at] != 6:
        at += 9 + struct.unpack_from("<Q", content, at + 1)[0]
    claim = bytearray(content)
    struct.pack_into("<Q", claim, at + 9 + 16, 10 << 30)
    file.write_bytes(claim)
    with pytest.raises(FileError, match=rf"byte {at}: a chunk claims to unpack to {10 << 30} bytes"):
        read_bag(file)
    bomb = zstd.compress(bytes(1 << 28))  # 256 MB of zeros in a few kB, called 100 bytes
    body = struct.pack("<QQQII", 0, 0, 100, 0, 4) + b"zstd" + struct.pack("<Q", len(bomb)) + bomb
    old = 9 + struct.unpack_from("<Q", content, at + 1)[0]
    file.write_bytes(content[:at] + struct.pack("<BQ", 6, len(body)) + body + content[at + old :])
    with pytest.raises(FileError, match="a chunk does not unpack to the 100 bytes it states"):
        read_bag(file)


RAPID = """MODULE Poses
  ! LOCAL VAR jointtarget old := [[1,1,1,1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]];
  LOCAL VAR jointtarget jHome:=[[0,-10.5,20,0,3e1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  CONST jointtarget jPath{2} := [ [[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]],
    [[-1,-2,-3,-4,-5,-6],[9E9,9E9,9E9,9E9,9E9,9E9]] ];
  CONST robtarget p1 := [[600,0,700],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
"""
MOVES = "  PROC main()\n    MoveAbsJ jPath{2}\\NoEOffs, v100, fine, tool0;\n    MoveAbsJ jHome, v100, fine, tool0;\n  ENDPROC\n"
PROGRAMS = [
    (RAPID, "RAPID", [[0, -10.5, 20, 0, 30, 0], [1, 2, 3, 4, 5, 6], [-1, -2, -3, -4, -5, -6]], [3, 4, 5], "declarations"),
    (RAPID + MOVES, "RAPID", [[-1, -2, -3, -4, -5, -6], [0, -10.5, 20, 0, 30, 0]], [5, 3], "moves to them"),
    (RAPID + "  FOR i FROM 1 TO 2 DO\n" + MOVES, "RAPID", None, [3, 4, 5], "own order cannot be read"),
    ("DEFDAT P\n; DECL E6AXIS X={A1 9,A2 9,A3 9,A4 9,A5 9,A6 9}\nDECL E6AXIS XP1={A1 1.5,A2 -90,A3 90.0,A4 0,A5 5E1,"
     "A6 0,E1 0}\nENDDAT\n", "KRL", [[1.5, -90, 90, 0, 50, 0]], [3], "as|written"),
    ("/PROG A\n/MN\n   1:J P[2] 10% FINE    ;\n   2:J P[1] 10% FINE    ;\n/POS\nP[1]{\n   GP1:\n\tUF : 0, UT : 1,\t\n"
     "\tJ1=     1.000 deg,\tJ2=     2.000 deg,\tJ3=    -3.000 deg\n};\nP[2:\"b\"]{\n   GP1:\n\tUF : 0, UT : 1,\n"
     "\tJ1= 4 deg,\tJ2= 5 deg,\tJ3= 6 deg\n};\n/END\n", "FANUC LS", [[4, 5, 6], [1, 2, -3]], [11, 6], "horizontal"),
    ("def a():\n  # movej([9,9,9,9,9,9])\n  movej([0.1, -1.5, 0, 0, 0, 0], a=1.4)\nend\n", "URScript",
     [np.degrees([0.1, -1.5, 0, 0, 0, 0]).tolist()], [3], "moves to them"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "dialect", "joints", "lines", "said"), PROGRAMS)
def test_programs(tmp_path: Path, text: str, dialect: str, joints: Any, lines: list[int], said: str) -> None:
    path = tmp_path / "program.txt"
    path.write_text(text)
    found = read_targets(path)
    assert (found.dialect, found.lines) == (dialect, lines)
    if joints is not None:
        np.testing.assert_allclose(found.joints_deg, joints)
    assert any(word in " ".join(found.notes + found.warnings) for word in said.split("|"))
    assert inspect(path)["kind"] == "joint-log"


POSE = "[[600,0,500],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
KRL_DATA = """&ACCESS RVP
DEFDAT  MEASURE PUBLIC
DECL E6POS XP0={X 500.0,Y 0.0,Z 800.0,A 0.0,B 90.0,C 0.0,S 2,T 10}
DECL E6AXIS XP1={A1 1.0,A2 -90.0,A3 90.0,A4 0.0,A5 0.0,A6 0.0,E1 0.0}
DECL E6AXIS Q[2]
Q[1]={E6AXIS: A1 2.0,A2 -90.0,A3 90.0,A4 0.0,A5 0.0,A6 0.0}
Q[2]={A1 3.0,A2 -90.0,A3 90.0,A4 0.0,A5 0.0,A6 0.0}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE,POINT2[] " "}
$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}
ENDDAT
"""
LS_GROUPS = """/PROG A
/POS
P[1]{
   GP1:
    UF : 0, UT : 1,
    J1= 1 deg, J2= 2 deg, J3= 3 deg
   GP2:
    UF : 0, UT : 1,
    J1= 77 deg
};
/END
"""
URSCRIPT = """def measure():
  global Waypoint_1_p=p[.4, .1, .3, 0, 3.14, 0]
  global Waypoint_1_q=[0.1, -1.5, 1, 0, 0, 0]
  here = [d2r(90), 0, 0, 0, 0, d2r(-45.0)]
  movej(here, a=1.4)
  movej(get_inverse_kin(Waypoint_1_p, qnear=Waypoint_1_q), a=1.39, v=1.05)
  movej(Waypoint_1_p)
  movel(p[.4, .1, .3, 0, 3.14, 0])
end
"""


def targets_of(folder: Path, text: str) -> Any:
    (folder / "program.txt").write_text(text)
    return read_targets(folder / "program.txt")


def test_rapid_with_declarations_of_poses_beside_joints(tmp_path: Path) -> None:
    text = RAPID.replace(
        "MODULE Poses\n", f"MODULE Poses\n  LOCAL PERS robtarget pA:={POSE};\n  PERS tooldata t:=[TRUE];\n"
    )
    found = targets_of(tmp_path, text)
    assert len(found.joints_deg) == 3
    assert "2 targets are left out because they are poses without joints: pA (line 2), p1 (line 8)" in found.warnings


def test_krl_with_declarations(tmp_path: Path) -> None:
    found = targets_of(tmp_path, KRL_DATA)
    assert found.names == ["XP1", "Q[1]", "Q[2]"]
    assert [q[0] for q in found.joints_deg] == [1, 2, 3]
    assert found.lines == [4, 6, 7]
    assert "1 targets are left out because they are poses without joints: XP0 (line 3)" in found.warnings
    moves = "DEF MEASURE()\n PTP Q[2]\n LIN XP0\n PTP XP1\nEND\n"
    found = targets_of(tmp_path, KRL_DATA + moves)
    assert found.names == ["Q[2]", "XP1"]
    assert "in the order in which the program moves to them" in found.notes


def test_fanuc_with_a_second_motion_group(tmp_path: Path) -> None:
    found = targets_of(tmp_path, LS_GROUPS)
    assert found.joints_deg == [[1, 2, 3]]
    assert any("beside GP1 are left out" in text for text in found.warnings)


def test_urscript_with_variables(tmp_path: Path) -> None:
    found = targets_of(tmp_path, URSCRIPT)
    np.testing.assert_allclose(found.joints_deg, [[90, 0, 0, 0, 0, -45], np.degrees([0.1, -1.5, 1, 0, 0, 0])])
    assert found.names == ["here", "Waypoint_1_q"]
    assert found.lines == [5, 6]
    assert any("1 moves to a pose count with the joints of their qnear" in text for text in found.warnings)
    said = "2 targets are left out because they are poses without joints: Waypoint_1_p (line 7), a move along"
    assert any(said in text for text in found.warnings)


def test_a_program_comes_in_through_a_map_by_its_content(tmp_path: Path) -> None:
    (tmp_path / "measure.dat").write_text(KRL_DATA)
    (tmp_path / "points.csv").write_text("x,y,z\n1,2,3\n4,5,6\n7,8,9\n")
    columns = "".join(f'{a}_mm = {{ from = "{a}", unit = "mm" }}\n' for a in "xyz")
    (tmp_path / "map.toml").write_text(f'[columns]\n{columns}[join]\npath = "measure.dat"\nby = "row"\n')
    lines = prepare(tmp_path / "points.csv", column_map=tmp_path / "map.toml").content.decode().splitlines()
    assert lines[0] == "x_mm,y_mm,z_mm,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"
    assert lines[3].startswith("7.0,8.0,9.0,3.0,-90.0,")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"MODULE m\nCONST robtarget p10:={POSE};\nMoveL p10,v100,fine,tool0;\nENDMODULE\n",
         r"line 2: holds poses and no joints: p10 \(line 2\). Store jointtargets: CJointT\(\)"),
        ("DEFDAT a\nDECL E6POS XP1={X 1,Y 2,Z 3,A 0,B 0,C 0}\n", r"line 2: holds poses and no joints: XP1 .*Store E6AXIS"),
        ("/PROG A\n/POS\nP[1]{\n GP1:\n X = 1 mm\n};\nP[7]{\n GP1:\n X = 2 mm\n};\n",
         r"line 3: are given as poses: P\[1\] \(line 3\), P\[7\] \(line 7\). Show them as joints"),
        ("movej(p[.4, .1, .3, 0, 3.14, 0])\n", r"line 1: holds poses and no joints: movej \(line 1\). Give movej joints"),
        ("movej(home)\n",
         r"line 1: movej goes to 'home', to which this program assigns no joints\. Write home = \[...\] before"),
    ],
)  # fmt: skip
def test_programs_of_poses_are_refused_with_every_place(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        targets_of(tmp_path, text)
    with pytest.raises(FileError, match=words):
        inspect(tmp_path / "program.txt")


def test_a_new_dialect_is_one_entry_and_its_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def find(program: Program) -> None:
        for match in re.finditer(r"GO (\d) (\d) (\d) (\d)", program.text):
            program.moves.append(program.add("GO", [(match[k], match.span(k)) for k in range(1, 5)]))

    monkeypatch.setitem(DIALECTS, "TOY", Dialect("TOY", (".toy",), re.compile("^TOYBOT"), find))
    assert targets_of(tmp_path, "TOYBOT 1\nGO 1 2 3 4\nGO 5 6 7 8\n").joints_deg == [[1, 2, 3, 4], [5, 6, 7, 8]]
    assert inspect(tmp_path / "program.txt")["kind"] == "joint-log"
    (tmp_path / "a.toy").write_text("TOYBOT 1\nGO 1 2 3 4\n")
    assert read_program(tmp_path / "a.toy").rewritten([[1.5, 2, 3, 4]]) == "TOYBOT 1\nGO 1.500000 2 3 4\n"


def test_joints_written_into_moves_are_targets_like_others(tmp_path: Path) -> None:
    """A list of joints and a program to be rewritten are read alike: what the one finds, the other does."""
    moves = "MoveAbsJ jHome,v1,z1,t;\nMoveAbsJ [[9,8,7,6,5,4],[9E9,9E9,9E9,9E9,9E9,9E9]],v1,z1,t;"
    rapid = f"{RAPID}PROC main()\n{moves}\nENDPROC\n"
    assert targets_of(tmp_path, rapid).joints_deg == [[0, -10.5, 20, 0, 30, 0], [9, 8, 7, 6, 5, 4]]
    krl = "DEF A()\nPTP {A1 1,A2 2,A3 3,A4 4}\nPTP_REL {A1 50,A2 0,A3 0,A4 0}\nPTP {A1 5,A2 6,A3 7,A4 8}\nEND\n"
    assert targets_of(tmp_path, krl).joints_deg == [[1, 2, 3, 4], [5, 6, 7, 8]]
    twice = "def a():\n q = [0.1, 0, 0]\n movej(q)\n q = [0.2, 0, 0]\n movej(q)\nend\n"
    np.testing.assert_allclose(np.radians(targets_of(tmp_path, twice).joints_deg)[:, 0], [0.1, 0.2])
    for ending, text in (("mod", rapid + "ENDMODULE\n"), ("src", krl), ("script", twice)):
        (tmp_path / f"a.{ending}").write_text(text)
        program = read_program(tmp_path / f"a.{ending}")
        moved = {target.joints_deg for target in program.moves if target is not None}
        assert moved == {tuple(q) for q in targets_of(tmp_path, text).joints_deg}
    degrees = "def a():\n movej([d2r(90), 0.5, d2r(-45.0)])\nend\n"  # numbers in degrees are rewritten in degrees
    (tmp_path / "d.script").write_text(degrees)
    program = read_program(tmp_path / "d.script")
    assert program.targets[0].joints_deg == (90.0, math.degrees(0.5), -45.0)
    new = program.rewritten([[91.0, math.degrees(0.75), -45.0]])
    assert new == degrees.replace("90", "91.000000").replace("0.5", "0.75000000")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (RAPID.replace("0,-10.5,20", "0,-10.5"), "line 3: jHome is not made of six joints and six external axes"),
        ("/PROG A\n/POS\nP[1]{\n GP1:\n X = 1 mm, Y = 2 mm\n};\n", r"line 3: P\[1\] is given as a pose. Show it as joints"),
        ("DECL E6AXIS X={A1 1,A3 2,A4 3,A5 4}\n", r"line 1: X lacks axes: it has \[1, 3, 4, 5\]"),
        ("movej([0,90,0,0,0,0])\n", "line 1: movej moves by more than two turns: are these degrees"),
        ("movej([a,b])\n", r"line 1: movej goes to '\[a,b\]', no list of numbers"),
        ("LOCAL VAR jointtarget a;\n", "holds no joint targets of RAPID"),
    ],
)  # fmt: skip
def test_bad_programs(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "a.mod"
    path.write_text(text)
    with pytest.raises(FileError, match=words):
        read_targets(path)


def test_match_takes_a_bag_by_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Offset and order of the joints come out right, with the elbow first in every message."""
    t, log_t = np.arange(0, 20, 1 / 100), np.arange(-1, 25, 1 / 125)
    points = arm(wander(t)) + np.random.default_rng(0).normal(0, 0.02, (len(t), 3, 3))
    recording = write_n3d(tmp_path / "a.n3d", points, 100.0)
    bag = write_bag(tmp_path / "bag", by_alphabet(wander(log_t - 2.5), log_t))
    assert run(["inspect", str(bag), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kind"] == "joint-log"
    assert found["rate_hz"] == pytest.approx(125)
    assert [c["name"] for c in found["columns"]] == ["elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint"]
    assert "give --joint-order" in found["warnings"][0]
    arguments = ["match", str(recording), str(bag), "--by", "frames", "--joint-order", ",".join(ARM), "--json"]
    assert run(arguments) == 0
    clock = json.loads(capsys.readouterr().out)["clock"]
    # the bag's time counts from its first message, a second before the log's zero
    assert clock["offset_s"] == pytest.approx(3.5, abs=max(2e-4, 4 * clock["offset_sigma_s"]))


@pytest.mark.parametrize("kind", ["mcap", "db3", "mod", "ls"])
def test_damaged_logs_are_refused_and_nothing_else(tmp_path: Path, kind: str) -> None:
    t = np.arange(20) / 100
    if kind in ("mcap", "db3"):
        seed = next(write_bag(tmp_path / "bag", by_alphabet(wander(t), t), kind).glob(f"*.{kind}")).read_bytes()
    else:
        seed = (RAPID + MOVES if kind == "mod" else PROGRAMS[4][0]).encode()
    path = tmp_path / f"damaged.{kind}"

    @settings(max_examples=60, deadline=5000, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(EDITS, st.booleans())
    def check(edits: list[tuple[str, int, bytes]], order: bool) -> None:
        path.write_bytes(edited(seed, edits))
        said = str(path)
        try:
            read_joint_log(path, hints=LogHints(order=ARM if order else ()))
        except FileError as error:
            said = error.detail
        assert str(path) in said

    check()
