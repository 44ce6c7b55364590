"""The disk turns read-only, or full, under a server that runs, and then not: reads go on, nothing is lost, no restart.

Linux refuses to remount a file system while files on it are open for writing; it is the kernel that does so, after an error of
the disk. Here a library that every process loads first refuses as it would; the last test has a kernel do it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_client.stream import CorrectedStream
from kilter_service.ground.settings import Settings
from kilter_service.run.backup.service import verify_stored
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, ready
from tests.service.preloaded import preloaded
from tests.service.test_failing_disk import api
from tests.service.test_serve import Server, children

Until = Callable[..., None]
REPOSITORY = Path(__file__).resolve().parents[2]
ROWS = 40
Q = (0.1, 0.6, 0.4, 0.3, 0.2)


class Disk:
    """What the processes of a server see."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.set("w")

    def set(self, state: str) -> None:
        """Read-only (`r`), full (`f`), or neither (`w`)."""
        with self._file.open("w", encoding="ascii") as file:
            file.write(state)


@pytest.fixture
def disk(settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Disk:
    monkeypatch.setenv("LD_PRELOAD", str(preloaded("disk", tmp_path)))
    monkeypatch.setenv("TEST_DISK", str(tmp_path / "disk"))
    monkeypatch.setenv("TEST_FOLDER", str(settings.data))
    return Disk(tmp_path / "disk")


@pytest.fixture
def server(disk: Disk, settings: Settings, migrated: Path) -> Iterator[Server]:
    ready(settings, migrated)
    server = Server(settings)
    yield server
    disk.set("w")
    assert server.stop() == 0
    assert server.process.stdout is not None
    server.process.stdout.close()


def made(client: httpx.Client) -> str:
    client.post("/v1/robots", json=Katana.document).raise_for_status()
    campaign = client.post("/v1/robots/katana/campaigns", json={"name": "one"}).raise_for_status().json()["id"]
    client.post(f"/v1/campaigns/{campaign}/observations", json=Katana().columns(ROWS)).raise_for_status()
    return str(campaign)


def writes(client: httpx.Client, campaign: str) -> list[httpx.Response]:
    """Send what stores something: measurements, a campaign, a job."""
    return [
        client.post(f"/v1/campaigns/{campaign}/observations", json=Katana().columns(ROWS, 1)),
        client.post("/v1/robots/katana/campaigns", json={"name": "two"}),
        asked(client, campaign),
    ]


def asked(client: httpx.Client, campaign: str) -> httpx.Response:
    body = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "options": {"level": 1}}
    return client.post("/v1/jobs", json=body)


def finished(client: httpx.Client, job: str, until: Until) -> dict[str, Any]:
    found: dict[str, Any] = {}

    def over() -> bool:
        found.update(client.get(f"/v1/jobs/{job}").json())
        return found["state"] not in ("queued", "running")

    until(over, seconds=60)
    return found


def test_writes_are_refused_with_the_remedy_and_reads_go_on(disk: Disk, settings: Settings, migrated: Path) -> None:
    ready(settings, migrated)
    with api(settings) as client:
        campaign = made(client)
        disk.set("r")
        for answer in writes(client, campaign):
            assert (answer.status_code, answer.json()["code"]) == (507, "disk_read_only"), answer.text
            assert "Mount it for writing" in answer.json()["detail"]
        assert [one["rows"] for one in client.get("/v1/robots/katana/campaigns").json()["campaigns"]] == [ROWS]
        disk.set("w")
        assert [answer.status_code for answer in writes(client, campaign)] == [201, 201, 202]
        assert client.get(f"/v1/campaigns/{campaign}").json()["rows"] == 2 * ROWS
    assert verify_stored(settings).damaged == []


@pytest.mark.slow
@pytest.mark.parametrize(("state", "code"), [("r", "disk_read_only"), ("f", "disk_full")], ids=["read-only", "full"])
def test_a_disk_that_cannot_be_written_and_can_again(
    server: Server, disk: Disk, settings: Settings, until: Until, state: str, code: str
) -> None:
    headers = {"Authorization": f"Bearer {admin_token(settings)}"}
    with httpx.Client(base_url=server.ready["url"], headers=headers, timeout=60) as client:
        campaign = made(client)
        version = finished(client, asked(client, campaign).json()["id"], until)["result"]["version_id"]
        client.post(f"/v1/versions/{version}/activate", json={}).raise_for_status()
        before = children(server.process.pid)
        given: dict[str, Any] = {"data": settings.data, "deadline_s": 5.0, "connect_timeout_s": 60.0, "settled": True}
        with CorrectedStream("katana", **given) as line:
            waiting = [asked(client, campaign).json()["id"] for _ in range(3)]
            disk.set(state)
            assert {(answer.status_code, answer.json()["code"]) for answer in writes(client, campaign)} == {(507, code)}
            used = [line.correct(Q).source for _ in range(50)]
            health: dict[str, Any] = {}

            def silent() -> bool:
                health.update(client.get("/v1/health").json()["checks"])
                return not health["worker"]["ok"] and not health["corrector"]["ok"]

            until(silent, seconds=40)
            assert health["database"]["ok"]
            if state == "r":
                assert "cannot be written: mount it for writing" in health["disk"]["detail"]
                assert "the disk cannot be written" in health["worker"]["detail"]
            used += [line.correct(Q).source for _ in range(50)]
            disk.set("w")
            until(lambda: client.get("/v1/health").json()["status"] == "ready", seconds=40)
            done = [finished(client, job, until) for job in (*waiting, asked(client, campaign).json()["id"])]
            assert {one["state"] for one in done} == {"succeeded"}, done
            used += [line.correct(Q).source for _ in range(50)]
        assert set(used) == {"corrected"}
        assert children(server.process.pid) == before
    assert verify_stored(settings).damaged == []


@pytest.mark.slow
def test_a_disk_that_the_kernel_makes_read_only(settings: Settings, migrated: Path, tmp_path: Path) -> None:
    """The real thing: ext4 after an error. What was acknowledged before is there when the disk was checked."""
    if os.geteuid() != 0 or not shutil.which("mkfs.ext4") or not shutil.which("losetup"):
        pytest.skip("to mount a disk needs root, and mkfs.ext4 and losetup")
    image = tmp_path / "image"
    with image.open("wb") as file:
        file.truncate(512 << 20)
    subprocess.run(["mkfs.ext4", "-q", "-F", str(image)], check=True)
    settings.data.mkdir(parents=True)
    namespace, mounted = ["unshare", "--mount"], f"mount -o loop,errors=remount-ro {image} {settings.data}"
    if subprocess.run([*namespace, "sh", "-c", mounted], capture_output=True).returncode:
        pytest.skip("this system does not mount a file")
    admin_token(settings)
    copied = f"cp {settings.token_file} {tmp_path} && {mounted} && cp {tmp_path}/token {migrated} {settings.data}/"
    script = f'{copied} && sync -f {settings.data} && exec "$@"'
    with api(settings, *namespace, "sh", "-c", script, "sh") as client:
        campaign = made(client)
        device = subprocess.run(
            ["losetup", "-n", "-O", "NAME", "-j", str(image)], capture_output=True, text=True
        ).stdout
        Path(f"/sys/fs/ext4/{Path(device.strip()).name}/trigger_fs_error").write_text("1", encoding="ascii")
        for answer in writes(client, campaign):
            assert (answer.status_code, answer.json()["code"]) == (507, "disk_read_only"), answer.text
        assert client.get(f"/v1/campaigns/{campaign}").json()["rows"] == ROWS
        assert "mount it for writing" in client.get("/v1/health").json()["checks"]["disk"]["detail"]
    subprocess.run(["fsck.ext4", "-fy", str(image)], capture_output=True, check=False)
    verify = [sys.executable, "-m", "kilter_service", "verify"]
    checked = subprocess.run(
        [*namespace, "sh", "-c", f'{mounted} && exec "$@"', "sh", *verify],
        env={**os.environ, **settings.environment()}, cwd=REPOSITORY, capture_output=True, text=True,
    )  # fmt: skip
    assert checked.returncode == 0, checked.stderr
    assert "1 campaigns with 1 chunks" in checked.stdout + checked.stderr
