"""Controllers on other machines, as the how-to prints it: two controllers, their robots, and why one is not taken."""

from __future__ import annotations

import datetime
import json
import re
import shlex
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import zenoh

from kilter_client.signing import Session, on_this_machine
from kilter_client.stream import CorrectedStream
from kilter_client.streaming.certificates import StreamError
from kilter_core.model import Calibration
from kilter_service.ground.settings import Settings
from kilter_service.run import zenoh_folders as issued
from kilter_service.run.zenoh_folders import load_or_make_authority, write_folders
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import Rules, with_free_port
from tests.corrector.conftest import MemorySource
from tests.corrector.live import Q, until
from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = (REPOSITORY / "docs" / "how-to" / "run-a-server.md").read_text(encoding="utf-8")
SECTION = PAGE.partition("## Controllers on other machines")[2].partition("\n## ")[0]
ROBOTS = {"left": ("arm1", "arm2"), "right": ("arm3",)}
PLACE, HOST, PORT = "/etc/kilter/zenoh", "cell7.lab", ":7447"


def blocks(kind: str = "") -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", SECTION, re.S | re.M)


def kilterd(line: str, folder: Path) -> None:
    """Run a command of the page, its folder and host being those of this machine."""
    words = shlex.split(line.replace(PLACE, str(folder)).replace(HOST, "localhost"))
    assert words[0] == "kilterd"
    environment = {"PATH": "/usr/bin:/bin", "KILTER_DATA": str(folder.parent / "data")}
    done = forked_command(*words[1:], environment=environment, folder=REPOSITORY)
    assert done.returncode == 0, done.stderr


@dataclass(frozen=True)
class Cell:
    """A corrector with three robots, reached by its host's name, and the folders of its controllers."""

    folder: Path
    corrector: Corrector

    @property
    def endpoint(self) -> str:
        return f"tls/localhost:{self.corrector.endpoints['stream'].rpartition(':')[2]}"

    def session(self, robot: str, stream: str) -> Session:
        """Keys as the API gives them: it derives them from the same file."""
        return on_this_machine(self.corrector.file.parent / "stream-keys.json", "local", robot, stream)

    def stream(self, role: str, robot: str, **options: object) -> CorrectedStream:
        name = f"{role}-{robot}"
        given = {
            "endpoints": [self.endpoint], "site": "local", "session": self.session(robot, name), "stream": name,
            "zenoh_config": self.folder / role / "zenoh.json5", "deadline_s": 2.0, "connect_timeout_s": 20.0,
            "settled": True, **options,
        }  # fmt: skip
        return CorrectedStream(robot, **given)  # type: ignore[arg-type]


@contextmanager
def running(folder: Path, config: Path, source: MemorySource, listen: str) -> Iterator[Cell]:
    settings = Settings(data=folder.parent / "data", zenoh_listen=listen, zenoh_config=config)
    corrector = Corrector(settings, source, Rules(max_age_ns=5_000_000_000))
    corrector.start()
    try:
        yield Cell(folder, corrector)
    finally:
        corrector.stop()


@pytest.fixture(scope="module")
def robots(katana: Calibration, active_of: Callable[..., Active]) -> MemorySource:
    made = MemorySource()
    for epoch, robot in enumerate(("arm1", "arm2", "arm3"), 1):
        made.use(replace(active_of(katana, epoch=epoch, ramp_s=0.05), robot=robot))
    return made


@pytest.fixture(scope="module")
def cell(robots: MemorySource, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """The two lines of the page: the folders are written, and the corrector runs with the variables of the second."""
    folder = tmp_path_factory.mktemp("cell") / "zenoh"
    write, serve = blocks()[0].strip().splitlines()
    assert PLACE in write
    assert HOST in write
    kilterd(write, folder)
    *variables, command, what = serve.split()
    assert (command, what) == ("kilterd", "serve")
    said = dict(one.split("=", 1) for one in variables)
    config = Path(said.pop("KILTER_ZENOH_CONFIG").replace(PLACE, str(folder)))
    listen = said.pop("KILTER_ZENOH_LISTEN")
    assert (said, listen) == ({}, f"tls/0.0.0.0{PORT}")
    with running(folder, config, robots, listen.replace(PORT, ":0")) as made:
        yield made


def test_each_controller_reaches_its_robots_and_no_other(cell: Cell) -> None:
    for name, own in ROBOTS.items():
        for robot in ("arm1", "arm2", "arm3"):
            if robot in own:
                with cell.stream(f"controller-{name}", robot) as stream:
                    assert [stream.correct(Q).source for _ in range(10)] == ["corrected"] * 10
            else:
                with pytest.raises(StreamError, match=rf"no right to robot '{robot}'.*--controller NAME=ROBOT"):
                    cell.stream(f"controller-{name}", robot, connect_timeout_s=1.0).__enter__()


def test_an_observer_is_told_that_it_may_only_listen(cell: Cell) -> None:
    with pytest.raises(StreamError, match=r"listen only: use the folder of a controller that has robot 'arm1'"):
        cell.stream("observer", "arm1", connect_timeout_s=3.0).__enter__()


def test_what_a_controller_sends_for_another_robot_does_not_arrive(cell: Cell) -> None:
    heard: dict[str, list[bytes]] = {"arm1": [], "arm3": []}

    def session(role: str) -> zenoh.Session:
        made = zenoh.Config.from_file(str(cell.folder / role / "zenoh.json5"))
        made.insert_json5("connect/endpoints", json.dumps([cell.endpoint]))
        return zenoh.open(made)

    def listen(of: zenoh.Session, robot: str) -> None:
        key = f"kilter/@v1/local/{robot}/stream/x/in"
        of.declare_subscriber(key, lambda sample: heard[robot].append(sample.payload.to_bytes()))

    with session("observer") as observer, session("controller-right") as right, session("controller-left") as left:
        for robot in heard:
            listen(observer, robot)

        def both_arrive() -> bool:
            left.put("kilter/@v1/local/arm3/stream/x/in", b"of left")
            right.put("kilter/@v1/local/arm1/stream/x/in", b"of right")
            left.put("kilter/@v1/local/arm1/stream/x/in", b"own of left")
            right.put("kilter/@v1/local/arm3/stream/x/in", b"own of right")
            return b"own of left" in heard["arm1"] and b"own of right" in heard["arm3"]

        until(both_arrive)
        assert set(heard["arm1"]) == {b"own of left"}
        assert set(heard["arm3"]) == {b"own of right"}


def test_the_controller_of_the_page_is_corrected(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Word for word, but for the host and its port."""
    (line,) = blocks("python")
    line = line.replace(f"tls/{HOST}{PORT}", cell.endpoint)
    monkeypatch.chdir(cell.folder / "controller-left")
    made: list[CorrectedStream] = []

    def opened(robot: str, **options: object) -> None:
        more = {"session": cell.session(robot, "main"), "deadline_s": 2.0, "connect_timeout_s": 20.0}
        made.append(CorrectedStream(robot, **options, **more))  # type: ignore[arg-type]

    exec(line, {"CorrectedStream": opened, "Path": Path})  # noqa: S102 - of our own page
    with made[0] as stream:
        assert [stream.correct(Q).source for _ in range(10)] == ["corrected"] * 10


def test_the_rotation_of_the_page_keeps_every_controller(cell: Cell, tmp_path: Path) -> None:
    (line,) = re.findall(r"^`(kilterd zenoh-config .*--rotate)`", SECTION, re.M)
    folder = tmp_path / "zenoh"
    subprocess.run(["cp", "-a", str(cell.folder), str(folder)], check=True)
    kilterd(line, folder)
    for name, own in ROBOTS.items():
        new = folder / f"controller-{name}" / "zenoh.json5"
        with cell.stream(f"controller-{name}", own[0], zenoh_config=new) as stream:
            assert stream.correct(Q).source == "corrected"


def refused(cell: Cell, **options: object) -> str:
    """What a stream says that is not opened."""
    with pytest.raises(StreamError) as caught:
        cell.stream("controller-left", "arm1", connect_timeout_s=1.0, **options).__enter__()
    return str(caught.value)


def folders(place: Path, hosts: tuple[str, ...], of: Path | None = None) -> Path:
    """Folders of all roles by an authority of their own, or by that of the cell."""
    if of is not None:
        subprocess.run(["cp", "-a", str(of), str(place)], check=True)
    write_folders(place, "local", hosts, 7447, ROBOTS, 0, *load_or_make_authority(place, rotate=False))
    return place


def test_a_corrector_of_another_authority_is_named(cell: Cell, tmp_path: Path) -> None:
    said = refused(cell, zenoh_config=folders(tmp_path / "own", ("localhost",)) / "controller-left" / "zenoh.json5")
    assert "authority that this controller does not trust" in said
    assert "kilterd zenoh-config" in said


def test_a_controller_of_another_authority_is_named(cell: Cell, tmp_path: Path) -> None:
    other = folders(tmp_path / "own", ("localhost",)) / "controller-left" / "zenoh.json5"
    document = json.loads(other.read_text().partition("\n")[2])
    real = json.loads((cell.folder / "controller-left" / "zenoh.json5").read_text().partition("\n")[2])
    tls = document["transport"]["link"]["tls"]
    tls["root_ca_certificate_base64"] = real["transport"]["link"]["tls"]["root_ca_certificate_base64"]
    mixed = tmp_path / "mixed.json5"
    mixed.write_text(json.dumps(document))
    assert "its certificate is of another authority" in refused(cell, zenoh_config=mixed)
    for part in ("connect_certificate_base64", "connect_private_key_base64"):
        tls.pop(part)
    mixed.write_text(json.dumps(document))
    assert "this controller's configuration has none" in refused(cell, zenoh_config=mixed)


def expired(monkeypatch: pytest.MonkeyPatch) -> None:
    """Certificates from now on have ended already."""
    monkeypatch.setattr(issued, "EARLIER", datetime.timedelta(days=30))
    monkeypatch.setattr(issued, "CERTIFICATE_DAYS", -1)


def test_an_expired_certificate_of_a_controller_is_named_and_the_remedy_helps(
    cell: Cell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as past:
        expired(past)
        place = folders(tmp_path / "zenoh", ("localhost",), cell.folder)
    file = place / "controller-left" / "zenoh.json5"
    assert re.search(
        r"its certificate has expired. Run `kilterd zenoh-config --rotate`", refused(cell, zenoh_config=file)
    )
    kilterd(f"kilterd zenoh-config --out {place} --rotate", place)
    with cell.stream("controller-left", "arm1", zenoh_config=file) as stream:
        assert stream.correct(Q).source == "corrected"


def test_an_expired_certificate_or_another_name_of_a_corrector_is_named(
    cell: Cell, robots: MemorySource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as past:
        expired(past)
        place = folders(tmp_path / "zenoh", ("localhost",), cell.folder)
    with running(place, place / "corrector" / "zenoh.json5", robots, "tls/0.0.0.0:0") as late:
        assert "shows a certificate that has expired" in refused(replace(late, folder=cell.folder))
    said = refused(cell, endpoints=[cell.endpoint.replace("localhost", "127.0.0.1")])
    assert "another name than '127.0.0.1'" in said
    assert "kilterd zenoh-config --host 127.0.0.1" in said


def test_a_port_where_nobody_listens_and_a_name_nobody_knows_are_named(cell: Cell) -> None:
    nobody = with_free_port("tls/localhost:0")
    assert refused(cell, endpoints=[nobody]).startswith(f"Nothing listens at {nobody}: is `kilterd serve` up there")
    assert "is not known by that name here" in refused(cell, endpoints=["tls/no-such-host.invalid:7447"])
    assert "give the file of this controller as `zenoh_config`" in refused(cell, zenoh_config=None)
