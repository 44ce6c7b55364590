"""Why a corrector and a controller do not accept each other's certificates, found out by a handshake of one's own.

zenoh says that no link came about, and of a certificate that the other side refuses not even that: with TLS 1.3 the
refusal comes after the handshake. This is asked only when a stream could not be opened.

Where the corrector is, and how a stream reaches it.
"""

from __future__ import annotations

import base64
import json
import os
import re
import socket
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kilter_files.ground.later import later

with later(__name__):
    import ssl


PATIENCE_S, ALERT_S = 3.0, 1.0
EXPIRED, NOT_YET, OTHER_NAMES = 10, 9, (62, 64)  # X509_V_ERR_… of OpenSSL
AGAIN = "copy this controller's folder anew from where `kilterd zenoh-config` of that corrector wrote it"
FILES = {  # of a zenoh configuration: what TLS calls them
    "trusted": "root_ca_certificate",
    "certificate": "connect_certificate",
    "key": "connect_private_key",
}


def why_not(zenoh: Any, endpoints: Sequence[str], file: Path | None) -> str | None:
    """Why no endpoint takes this controller, in a sentence; None where the certificates are accepted, or there are none."""
    secure = [endpoint for endpoint in endpoints if endpoint.startswith("tls/")]
    if not secure:
        return None
    if file is None:
        return (
            f"The corrector at {secure[0]} asks for a certificate: give the file of this controller as `zenoh_config`."
        )
    with tempfile.TemporaryDirectory() as place:  # of its owner only
        files, by_name = _written(zenoh, file, Path(place))
        found = [_handshake_problem(endpoint, files, by_name) for endpoint in dict.fromkeys(secure)]
    return None if None in found else found[0]


def _written(zenoh: Any, file: Path, place: Path) -> tuple[dict[str, Path], bool]:
    """Certificates of a zenoh configuration as files, and whether names are compared."""
    config = zenoh.Config.from_file(str(file))
    files = {}
    for what, name in FILES.items():
        inside, path = (json.loads(config.get_json(f"transport/link/tls/{name}{end}")) for end in ("_base64", ""))
        if inside:
            files[what] = place / what
            files[what].write_bytes(base64.b64decode(inside))
        elif path:
            files[what] = Path(path)
    return files, json.loads(config.get_json("transport/link/tls/verify_name_on_connect")) is not False


def _handshake_problem(endpoint: str, files: dict[str, Path], by_name: bool) -> str | None:
    where = f"The corrector at {endpoint}"
    host, _, port = endpoint.partition("/")[2].partition("?")[0].partition("#")[0].rpartition(":")
    host = host.strip("[]")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = by_name
    try:
        if "trusted" in files:
            context.load_verify_locations(files["trusted"])
        if "certificate" in files and "key" in files:
            context.load_cert_chain(files["certificate"], files["key"])
    except (OSError, ssl.SSLError) as error:
        return f"The certificates of this controller cannot be read ({error}): {AGAIN}."
    try:
        with (
            socket.create_connection((host, int(port)), PATIENCE_S) as plain,
            context.wrap_socket(plain, server_hostname=host) as link,
        ):
            link.settimeout(ALERT_S)
            link.recv(1)
    except ssl.SSLCertVerificationError as error:
        return _their_fault(where, host, error)
    except ssl.SSLError as error:
        return _our_fault(where, error)
    except socket.gaierror:
        return f"{where} is not known by that name here: give an address, or a name that this machine can resolve."
    except TimeoutError as error:
        return None if str(error).startswith("The read") else f"{where} does not answer: {_UP}"
    except OSError:
        return f"Nothing listens at {endpoint}: {_UP}"
    return None


_UP = "is `kilterd serve` up there, with KILTER_ZENOH_LISTEN on this port, and no firewall between?"


def _their_fault(where: str, host: str, error: ssl.SSLCertVerificationError) -> str:
    """What is wrong with the corrector's certificate, as this controller sees it."""
    if error.verify_code in (EXPIRED, NOT_YET):
        when = "has expired" if error.verify_code == EXPIRED else "is not valid yet by this machine's clock"
        return f"{where} shows a certificate that {when}: {_ROTATE} and start the corrector with its new folder."
    if error.verify_code in OTHER_NAMES:
        return (
            f"{where} shows a certificate for another name than {host!r}: give the endpoint by a name that it has, or write it "
            f"again with `kilterd zenoh-config --host {host}` and start the corrector with its new folder."
        )
    return f"{where} shows a certificate of an authority that this controller does not trust: {AGAIN}."


_ROTATE = "run `kilterd zenoh-config --rotate`"


def _our_fault(where: str, error: ssl.SSLError) -> str:
    """What the corrector finds wrong with this controller's certificate, by its alert."""
    alert = str(error.reason or error)
    if "EXPIRED" in alert:
        return f"{where} refuses this controller: its certificate has expired. {_ROTATE[0].upper()}{_ROTATE[1:]}, and {AGAIN}."
    if "REQUIRED" in alert:
        return f"{where} asks for a certificate, and this controller's configuration has none: {AGAIN}."
    return f"{where} refuses this controller: its certificate is of another authority. {AGAIN[0].upper()}{AGAIN[1:]}."


class StreamError(Exception):
    """The stream cannot be opened or used so; the message says what to do."""


_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def robot_key_prefix(site: str, robot: str, stream: str) -> str:
    """Keys of a robot begin so.

    Raises:
        StreamError: a name cannot be part of a key, so nobody would ever answer.

    """
    for what, name in (("site", site), ("robot", robot), ("stream", stream)):
        if not _NAME.fullmatch(name):
            raise StreamError(
                f"{what} {name!r} cannot be part of a stream key: use 1 to 64 letters, digits, '_', '-' or '.', "
                "starting with a letter or digit."
            )
    return f"kilter/@v1/{site}/{robot}"


def find_corrector(data: Path | None = None) -> dict[str, Any]:
    """Read the corrector file of this machine: site and endpoints.

    Raises:
        StreamError: there is none.

    """
    folder = data or Path(os.environ.get("KILTER_DATA") or Path.home() / ".kilter")
    try:
        document: dict[str, Any] = json.loads((folder / "corrector.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StreamError(
            f"No corrector was found through {folder / 'corrector.json'}: start `kilterd serve`, set KILTER_DATA, "
            "or give endpoints."
        ) from error
    return document


def session_config(zenoh: Any, endpoints: Sequence[str], file: Path | None = None) -> Any:
    """Peer that connects to the endpoints and to nobody else, and comes back within a quarter of a second.

    ``file`` is a zenoh configuration with the certificates of this controller.
    """
    config = zenoh.Config.from_file(str(file)) if file else zenoh.Config()
    settings: dict[str, object] = {
        "listen/endpoints": [],
        "connect/endpoints": list(dict.fromkeys(endpoints)),
        "connect/timeout_ms": 0,
        "connect/retry": {"period_init_ms": 20, "period_max_ms": 250, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": 1000,
    }
    if not file:
        settings["mode"] = "peer"
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
