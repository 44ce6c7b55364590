"""The image: what it promises is tried in a root that cannot be written; built where a container engine runs."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from numba.core.caching import UserProvidedCacheLocator

REPOSITORY = Path(__file__).resolve().parents[2]
DOCKERFILE = (REPOSITORY / "Dockerfile").read_text(encoding="utf-8")
# The root becomes read-only for this process and its children alone; /tmp is memory, as `docker run --tmpfs /tmp` makes it.
ENTER = """
mount --make-rprivate / && mount --bind "$1" /mnt && mount -t tmpfs none /tmp && mount -o remount,ro,bind / &&
u="$2" && shift 2 &&
exec setpriv --reuid "$u" --regid "$u" --clear-groups --no-new-privs --inh-caps=-all --bounding-set=-all "$@"
"""


def instruction(name: str) -> str:
    """The last instruction of a name in the Dockerfile, on one line."""
    return re.findall(rf"^{name} +(.*(?:(?<=\\)\n.*)*)", DOCKERFILE, re.MULTILINE)[-1].replace("\\\n", " ")


def environment() -> dict[str, str]:
    """The image's own variables, with the mounted folder as /data."""
    found = dict(word.split("=", 1) for word in shlex.split(instruction("ENV")))
    found["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return {name: value.replace("/data", "/mnt") for name, value in found.items()}


def test_the_image_runs_as_a_user_without_rights_and_reports_its_health() -> None:
    assert instruction("USER") == "10001"
    assert instruction("HEALTHCHECK").rpartition("CMD ")[2].startswith('["python", "-c"')
    assert instruction("VOLUME") == "/data"
    assert "TOKEN" not in instruction("ENV")


def _keep_kernels(folder: Path) -> None:
    """Copy the compiled kernels to where the image keeps them, so that the server need not compile for minutes."""
    for kept in REPOSITORY.glob("core/**/__pycache__/*.kernels"):
        source = kept.parent.parent / f"{kept.name.rpartition('-')[0]}.py"
        place = UserProvidedCacheLocator.get_suitable_cache_subpath(str(source))
        shutil.copytree(kept, folder / place / kept.name)


def _enters(user: str) -> bool:
    """Whether a user without capabilities runs this Python in a root that cannot be written."""
    program = [sys.executable, "-c", "import sys; print(sys.version_info[:3])"]
    with tempfile.TemporaryDirectory() as folder:
        command = ["unshare", "--mount", "sh", "-c", ENTER, "enter", folder, user, *program]
        done = subprocess.run(command, capture_output=True, text=True)
    return done.stdout.strip() == str(sys.version_info[:3])


@pytest.fixture(scope="module")
def user() -> str:
    """The image's user, or root without its rights where others cannot read this Python."""
    if os.geteuid() == 0 and shutil.which("unshare"):
        for user in (instruction("USER"), "0"):
            if _enters(user):
                return user
    pytest.skip("a read-only root needs the right to mount")


@pytest.fixture(scope="module")
def data(user: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    _keep_kernels(folder / "kernels")
    for path in (folder, *folder.rglob("*")):
        os.chown(path, int(user), int(user))
    return folder


@pytest.fixture(scope="module")
def server(user: str, data: Path) -> Iterator[dict[str, Any]]:

    token = "a-token-of-forty-characters-for-this-test"
    process = subprocess.Popen(
        ["unshare", "--mount", "sh", "-c", ENTER, "enter", str(data), user, *json.loads(instruction("CMD"))],
        env={**environment(), "KILTER_TOKEN": token, "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"},
        cwd="/",
        stdout=subprocess.PIPE,
        text=True,
    )
    watch = threading.Timer(120, process.kill)
    watch.start()
    assert process.stdout is not None
    try:
        yield {"token": token, "pid": process.pid, **json.loads(process.stdout.readline() or "{}")}
    finally:
        watch.cancel()
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
        process.stdout.close()


def test_the_server_works_where_only_its_data_can_be_written(server: dict[str, Any], data: Path, user: str) -> None:
    port = httpx.URL(server["url"]).port
    url = f"http://127.0.0.1:{port}"
    access = {"Authorization": f"Bearer {server['token']}"}
    status = Path(f"/proc/{server['pid']}/status").read_text(encoding="ascii")
    assert re.search(rf"^Uid:\s+{user}\s", status, re.MULTILINE)
    assert re.search(r"^CapEff:\s+0+$", status, re.MULTILINE)
    assert " / ro" in Path(f"/proc/{server['pid']}/mountinfo").read_text(encoding="ascii")
    robot = {"name": "arm", "convention": "preset", "preset": "katana450-chapter4"}
    rows = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,x_mm,y_mm,z_mm\n1,20,30,-40,5,300,20,400\n"
    with httpx.Client(base_url=f"{url}/v1", headers=access, timeout=60) as http:
        assert http.post("robots", json=robot).status_code == 201
        campaign = http.post("robots/arm/campaigns", json={"name": "a"}).json()["id"]
        stored = http.post(f"campaigns/{campaign}/observations", content=rows, headers={"Content-Type": "text/csv"})
    assert stored.status_code in (200, 201), stored.text
    assert (data / "kilter.sqlite").stat().st_uid == int(user)


def test_the_health_check_of_the_image_says_ready_and_not(server: dict[str, Any]) -> None:
    check = json.loads(instruction("HEALTHCHECK").rpartition("CMD ")[2])
    run = {"PATH": environment()["PATH"]}
    port = str(httpx.URL(server["url"]).port)
    assert subprocess.run(check, env={**run, "KILTER_PORT": port}, timeout=30).returncode == 0
    assert subprocess.run(check, env={**run, "KILTER_PORT": "1"}, capture_output=True, timeout=30).returncode == 1


def test_the_image_is_built(tmp_path: Path) -> None:
    engine = next((name for name in ("docker", "podman") if shutil.which(name)), None)
    if engine is None or subprocess.run([engine, "info"], capture_output=True, timeout=60).returncode != 0:
        pytest.skip("no container engine runs here")
    command = [engine, "build", "--quiet", "--tag", "kilter-test", str(REPOSITORY)]
    built = subprocess.run(command, capture_output=True, text=True, timeout=1800)
    if "pull" in built.stderr and built.returncode != 0:
        pytest.skip("the base image cannot be had here")
    assert built.returncode == 0, built.stderr
    read_only = ["--rm", "--read-only", "--tmpfs=/tmp", "kilter-test", "kilterd", "migrate"]
    migrated = subprocess.run([engine, "run", *read_only], capture_output=True, text=True, timeout=300)
    assert migrated.returncode == 0, migrated.stderr
