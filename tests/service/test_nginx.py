"""The example of a proxy, run by a real nginx in front of the service: events, bodies, addresses."""

from __future__ import annotations

import os
import shutil
import socket
import ssl
import subprocess
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "proxy" / "nginx.conf"
NAME = "cell.example"
NGINX = shutil.which("nginx", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
MOST_MB = 2
OUTSIDE = "127.0.0.2"
TEMPORARY = "".join(
    f"{name}_temp_path {{folder}}/{name};\n" for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
)
MAIN = f"""
{{user}}daemon off; master_process off; pid {{folder}}/pid; error_log {{folder}}/error.log;
events {{{{}}}}
http {{{{ access_log off; {TEMPORARY} include {{folder}}/kilter.conf; }}}}
"""

pytestmark = pytest.mark.skipif(NGINX is None, reason="nginx is not installed: apt-get install nginx-light")
Until = Callable[..., None]


class Proxied(NamedTuple):
    """A client of nginx, and one of the service behind it."""

    outside: httpx.Client
    token: str


def certificate(folder: Path) -> None:
    """A certificate for the example's name and for loopback, where the test connects to."""
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, NAME)])
    built = x509.CertificateBuilder(name, name, key.public_key(), 7, now - timedelta(hours=1), now + timedelta(days=1))
    names = x509.SubjectAlternativeName([x509.DNSName(NAME), x509.IPAddress(ip_address("127.0.0.1"))])
    made = built.add_extension(names, critical=False).sign(key, hashes.SHA256())
    (folder / "cert.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
    written = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    (folder / "key.pem").write_bytes(key.private_bytes(*written))


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    return port


def site(folder: Path, behind: str, port: int) -> str:
    """The example with the test's own places; every other line as it is printed."""
    text = EXAMPLE.read_text(encoding="utf-8")
    for printed, here in (
        ("server 127.0.0.1:8730;", f"server {behind};"),
        ("listen 443 ssl http2;", f"listen 127.0.0.1:{port} ssl http2;"),
        ("/etc/kilter/", f"{folder}/"),
    ):
        assert printed in text
        text = text.replace(printed, here)
    return text


@pytest.fixture
def proxied(
    settings: Settings, database: Database, serve: Callable[..., httpx.Client], tmp_path: Path, until: Until
) -> Iterator[Proxied]:
    settings = settings.model_copy(update={"proxy": "127.0.0.1", "hosts": NAME, "max_upload_mb": MOST_MB})
    behind = serve(create_app(settings)).base_url
    folder, port = tmp_path / "nginx", free_port()
    folder.mkdir()
    certificate(folder)
    (folder / "kilter.conf").write_text(site(folder, f"{behind.host}:{behind.port}", port))
    user = "user root; " if os.geteuid() == 0 else ""
    (folder / "nginx.conf").write_text(MAIN.format(folder=folder, user=user))
    command = [str(NGINX), "-p", str(folder), "-e", str(folder / "error.log"), "-c", str(folder / "nginx.conf")]
    checked = subprocess.run([*command, "-t"], capture_output=True, text=True, timeout=30, check=False)
    assert checked.returncode == 0, checked.stderr
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as nginx:
        try:
            context = ssl.create_default_context(cafile=folder / "cert.pem")
            # From an address that is not the proxy's, as other machines are.
            transport = httpx.HTTPTransport(verify=context, local_address=OUTSIDE)
            with httpx.Client(transport=transport, base_url=f"https://127.0.0.1:{port}", timeout=60) as client:
                client.headers["Host"] = NAME
                until(lambda: answers(client), seconds=30)
                yield Proxied(client, admin_token(settings))
        finally:
            nginx.terminate()
            nginx.wait(20)


def answers(client: httpx.Client) -> bool:
    try:
        return client.get("/v1/health/live").status_code == 200
    except httpx.TransportError:
        return False


def test_events_pass_at_once_and_end_with_the_job(proxied: Proxied, katana: Any) -> None:
    client = proxied.outside
    client.headers["Authorization"] = f"Bearer {proxied.token}"
    campaign = katana.campaign(client, 30)
    asked = {"kind": "identify", "robot": katana.name, "campaigns": [campaign]}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    with client.stream("GET", f"/v1/jobs/{job}/events", timeout=20) as answer:
        lines = answer.iter_lines()
        assert "event: progress" in (next(lines), next(lines))  # while the job waits: nothing would fill a buffer
        client.post(f"/v1/jobs/{job}/cancel").raise_for_status()
        rest = "\n".join(lines)
    assert "event: end" in rest
    with client.stream("GET", f"/robots/{katana.name}/stream/events", timeout=20) as answer:
        lines = answer.iter_lines()
        assert next(lines).startswith("retry:")
        assert any(line.startswith("data:") for line in lines)


def test_a_body_within_the_limit_passes_and_a_larger_one_is_refused_by_kilter(proxied: Proxied, katana: Any) -> None:
    client = proxied.outside
    client.headers["Authorization"] = f"Bearer {proxied.token}"
    campaign = katana.campaign(client, 30)
    columns = katana.columns(10_000, seed=3)
    cells = zip(*columns.values(), strict=True)
    csv = (",".join(columns) + "\n" + "\n".join(",".join(f"{v:.9f}" for v in row) for row in cells)).encode()
    assert 1 << 20 < len(csv) < MOST_MB << 20  # more than nginx takes where nothing is said
    place = f"/v1/campaigns/{campaign}/observations"
    sent = client.post(place, content=csv, headers={"Content-Type": "text/csv"})
    assert sent.status_code == 201, sent.text
    larger = client.post(place, content=csv * 4, headers={"Content-Type": "text/csv"})
    assert (larger.status_code, larger.json()["code"]) == (413, "upload_too_large")
    assert larger.json()["request_id"] == larger.headers["x-request-id"]


def test_who_sends_is_known_by_the_proxys_word_and_needs_a_token(proxied: Proxied) -> None:
    client = proxied.outside
    assert client.get("/v1/robots").status_code == 401  # though nginx is on this machine
    client.headers["Authorization"] = f"Bearer {proxied.token}"
    robot = {"name": "arm", "convention": "preset", "preset": "ur10"}
    invented = {"X-Forwarded-For": "203.0.113.9"}
    client.post("/v1/robots", json=robot, headers=invented).raise_for_status()
    added = [one for one in client.get("/v1/audit").json()["entries"] if "/v1/robots" in one["route"]]
    assert [one["address"] for one in added] == [OUTSIDE]
    assert client.get("/v1/robots", headers={"Host": "other.example"}).status_code == 421


def test_whoever_logs_in_gets_a_cookie_for_tls_only(proxied: Proxied) -> None:
    origin = {"Origin": f"https://{NAME}"}
    done = proxied.outside.post("/login", data={"token": proxied.token}, headers=origin)
    assert done.status_code == 303, done.text
    assert "secure" in done.headers["set-cookie"].lower()
