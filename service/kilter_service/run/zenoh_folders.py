"""One folder per role, to be copied to its machine: a zenoh configuration, and the certificates it contains.

The configuration contains the certificates (base64), so that it works from wherever it is copied to.

At a rotation the new authority is also signed by the one before. This cross certificate goes with every new certificate, so
whoever trusts only the old authority accepts new certificates as well: nothing has to be restarted or copied at once.
"""

from __future__ import annotations

import argparse
import base64
import datetime
import ipaddress
import json
import os
import re
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.later import later
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings

with later(__name__):
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509 import oid

    from kilter_service.stream.corrector import endpoints


CORRECTOR, OBSERVER, ROS = "kilter-corrector", "kilter-observer", "kilter-ros"
# What each role may do on which keys, as zenoh's access control at the corrector; what is not allowed is denied.
#
# Flows are seen from the corrector: ingress is what a role sends to it, egress what it gets.

ANY_ROBOT = ("*",)
SUBSCRIBE = ["declare_subscriber"]
ASK = ["query", "declare_liveliness_subscriber", "liveliness_query"]


def controller_name(name: str) -> str:
    """Common name of a controller's certificate."""
    return f"kilter-controller-{name}"


def access_control(site: str, controllers: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """Rules of the corrector; ``controllers`` are the robots of each, ``("*",)`` for all."""
    rules: list[dict[str, Any]] = [_rule("inside", "both", _EVERY_MESSAGE, ["**", "kilter/@v1/**"])]
    rules[0]["key_exprs"] += _robot_key_expressions(site, ANY_ROBOT, ("active", "@rpc/*", "@alive/*"))
    # The query process meets the stream process in a socket that only their account can reach.
    subjects: list[dict[str, Any]] = [{"id": "inside", "link_protocols": ["unixsock-stream"]}]
    policies: list[dict[str, Any]] = [{"rules": ["inside"], "subjects": ["inside"]}]
    for name, robots in controllers.items():
        made = _controller(name, site, robots)
        rules += made
        subjects.append({"id": name, "cert_common_names": [controller_name(name)]})
        policies.append({"rules": [rule["id"] for rule in made], "subjects": [name]})
    made = _observer(site)
    rules += made
    subjects.append({"id": "observer", "cert_common_names": [OBSERVER]})
    policies.append({"rules": [rule["id"] for rule in made], "subjects": ["observer"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def ros_access_control(domain: int) -> dict[str, Any]:
    """Rules of a router of ROS: its nodes on the same machine, and the adaptor by its certificate."""
    every = _rule("ros", "both", _EVERY_MESSAGE, [f"{domain}/**", "@ros2_lv/**", "kilter/@v1/**"])
    subjects: list[dict[str, Any]] = [
        {"id": "nodes", "interfaces": ["lo"]},
        {"id": "adaptor", "cert_common_names": [ROS]},
    ]
    policies = [{"rules": ["ros"], "subjects": ["nodes", "adaptor"]}]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [every],
        "subjects": subjects,
        "policies": policies,
    }


_EVERY_MESSAGE = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
]


def _rule(name: str, flow: str, messages: list[str], key_exprs: list[str]) -> dict[str, Any]:
    flows = ["ingress", "egress"] if flow == "both" else [flow]
    return {"id": name, "permission": "allow", "flows": flows, "messages": messages, "key_exprs": key_exprs}


def _robot_key_expressions(site: str, robots: tuple[str, ...], parts: tuple[str, ...]) -> list[str]:
    return [f"{endpoints.PREFIX}/{site}/{robot}/{part}" for robot in robots for part in parts]


def _controller(name: str, site: str, robots: tuple[str, ...]) -> list[dict[str, Any]]:
    sends = _robot_key_expressions(site, robots, ("stream/*/in",))
    said = _robot_key_expressions(site, robots, ("stream/*/out", "stream/*/status", "active"))
    answered = _robot_key_expressions(site, robots, ("active", "@rpc/*"))
    alive = _robot_key_expressions(site, robots, ("@alive/*",))
    # The corrector declares once what it takes of all robots. Whoever may not know of that could send nothing at all; what
    # is sent and asked is still judged robot by robot.
    taken = _robot_key_expressions(site, ANY_ROBOT, ("stream/*/in",))
    offered = _robot_key_expressions(site, ANY_ROBOT, ("active", "@rpc/*"))
    return [
        _rule(f"{name}-sends", "ingress", ["put"], sends),
        _rule(f"{name}-hears-of", "egress", SUBSCRIBE, taken),
        _rule(f"{name}-listens", "ingress", SUBSCRIBE, said),
        _rule(f"{name}-hears", "egress", ["put"], said),
        _rule(f"{name}-asks", "ingress", ["query"], answered),
        _rule(f"{name}-is-offered", "egress", ["declare_queryable"], offered),
        _rule(f"{name}-is-answered", "egress", ["reply"], answered),
        _rule(f"{name}-looks", "ingress", ["declare_liveliness_subscriber", "liveliness_query"], alive),
        _rule(f"{name}-sees", "egress", ["liveliness_token", "reply"], alive),
    ]


def _observer(site: str) -> list[dict[str, Any]]:
    said = _robot_key_expressions(site, ANY_ROBOT, ("stream/*/*", "active"))
    answered = _robot_key_expressions(site, ANY_ROBOT, ("active", "@rpc/describe"))
    alive = _robot_key_expressions(site, ANY_ROBOT, ("@alive/*",))
    return [
        _rule("observer-listens", "ingress", SUBSCRIBE, said),
        _rule("observer-hears", "egress", ["put"], said),
        _rule("observer-asks", "ingress", ["query"], answered),
        _rule("observer-is-answered", "egress", ["reply", "declare_queryable"], answered),
        _rule("observer-looks", "ingress", ["declare_liveliness_subscriber", "liveliness_query"], alive),
        _rule("observer-sees", "egress", ["liveliness_token", "reply"], alive),
    ]


AUTHORITY = "authority"
CERTIFICATE, KEY, TRUSTED, CONFIG = "certificate.pem", "key.pem", "authorities.pem", "zenoh.json5"
ROS_ENDPOINTS = ("tcp/127.0.0.1:7447", "tls/0.0.0.0:7448")
HEADER = "// Written by `kilterd zenoh-config`. It contains a private key: keep it readable by its owner only.\n"


def write_private(file: Path, data: bytes) -> None:
    """Write a file only its owner can read, whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    file.parent.chmod(0o700)
    draft = file.with_name(f".{file.name}.{os.getpid()}")
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as out:
        out.write(data)
    draft.replace(file)


def load_or_make_authority(folder: Path, rotate: bool) -> tuple[Authority, bytes]:
    """The authority of a folder, made when there is none or at a rotation, and all certificates to trust (PEM).

    Raises:
        ServiceError: its files are damaged.

    """
    place = folder / AUTHORITY
    if not (place / KEY).exists():
        made = new_authority()
        trusted = pem(made.certificate)
    else:
        try:
            before = _read(place)
        except (ValueError, TypeError, OSError) as error:
            raise ServiceError(
                f"The authority in {place} cannot be read ({error}): restore the folder from a backup, or delete it and "
                "copy all folders anew.",
                code="option_invalid",
            ) from error
        if not rotate:
            return before, (place / TRUSTED).read_bytes()
        made = new_authority(before)
        trusted = pem(made.certificate) + pem(before.certificate)
    write_private(place / KEY, key_pem(made.key))
    write_private(place / CERTIFICATE, pem(made.certificate) + (pem(made.cross) if made.cross else b""))
    write_private(place / TRUSTED, trusted)
    return made, trusted


def _read(place: Path) -> Authority:
    key = serialization.load_pem_private_key((place / KEY).read_bytes(), None)
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise TypeError("another kind of key")
    own, *cross = x509.load_pem_x509_certificates((place / CERTIFICATE).read_bytes())
    return Authority(own, key, cross[0] if cross else None)


def tls(issued: Issued, trusted: bytes, listens: bool) -> dict[str, Any]:
    """TLS of a zenoh configuration: both sides show their certificates."""
    text = {name: base64.b64encode(data).decode() for name, data in vars(issued).items()}
    made: dict[str, Any] = {
        "root_ca_certificate_base64": base64.b64encode(trusted).decode(),
        "connect_private_key_base64": text["key"],
        "connect_certificate_base64": text["certificate"],
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": False,  # a link that moves an arm is not cut; the next one needs a valid certificate
    }
    if listens:
        made |= {"listen_private_key_base64": text["key"], "listen_certificate_base64": text["certificate"]}
    return made


def _config(tls_of_role: dict[str, Any], mode: str, connect: str | None, more: dict[str, Any]) -> bytes:
    protocols = ["tls", "tcp"] if mode == "router" else ["tls", "unixsock-stream"]
    document: dict[str, Any] = {
        "mode": mode,
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": {"protocols": protocols, "tx": {"lease": 1000}, "tls": tls_of_role}},
        **more,
    }
    if connect is not None:
        document["connect"] = {"endpoints": [connect]}
        document["listen"] = {"endpoints": []}
    return (HEADER + json.dumps(document, indent=1) + "\n").encode()


def write_folders(
    folder: Path,
    site: str,
    hosts: tuple[str, ...],
    port: int,
    controllers: Mapping[str, tuple[str, ...]],
    domain: int,
    authority: Authority,
    trusted: bytes,
    given: Issued | None = None,
) -> list[Path]:
    """Write the folder of each role; returns them. ``given`` is a certificate of the corrector from elsewhere."""
    connect = f"tls/{hosts[0]}:{port}"
    issued = given or issue(authority, CORRECTOR, hosts)
    rules = {"access_control": access_control(site, controllers)}
    made = {"corrector": (issued, _config(tls(issued, trusted, True), "peer", None, rules))}
    clients = {f"controller-{name}": controller_name(name) for name in controllers}
    for role, common_name in {**clients, "observer": OBSERVER}.items():
        own = issue(authority, common_name)
        made[role] = (own, _config(tls(own, trusted, False), "client", connect, {}))
    ros, router = issue(authority, ROS), issue(authority, "kilter-ros-router", hosts)
    # Nodes of the router's own machine connect without TLS, as they do by default.
    rules = {"access_control": ros_access_control(domain), "listen": {"endpoints": list(ROS_ENDPOINTS)}}
    made["ros"] = (ros, _config(tls(ros, trusted, False), "client", None, {}))
    made["ros-router"] = (router, _config(tls(router, trusted, True), "router", None, rules))
    for role, (own, config) in made.items():
        for name, data in ((CERTIFICATE, own.certificate), (KEY, own.key), (TRUSTED, trusted), (CONFIG, config)):
            write_private(folder / role / name, data)
    return [folder / role for role in made]


AUTHORITY_DAYS, CERTIFICATE_DAYS = 3650, 398
EARLIER = datetime.timedelta(hours=1)  # clocks of machines differ


@dataclass(frozen=True)
class Authority:
    """Certificate and key of an authority; ``cross`` is the same key certified by the authority before it."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey
    cross: x509.Certificate | None = None


@dataclass(frozen=True)
class Issued:
    """A role's certificate with its chain, and its key, PEM."""

    certificate: bytes
    key: bytes


def new_authority(before: Authority | None = None) -> Authority:
    """A new authority; the one before certifies it, too."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"Kilter stream {x509.random_serial_number() % 10**8:08d}")
    own = _sign_authority(name, key, name, key)
    cross = _sign_authority(name, key, before.certificate.subject, before.key) if before else None
    return Authority(own, key, cross)


def issue(authority: Authority, common_name: str, hosts: tuple[str, ...] = ()) -> Issued:
    """A certificate for a role; ``hosts`` are names and addresses of a machine that listens."""
    key = ec.generate_private_key(ec.SECP256R1())
    usages = [oid.ExtendedKeyUsageOID.CLIENT_AUTH, *([oid.ExtendedKeyUsageOID.SERVER_AUTH] if hosts else [])]
    builder = _builder(_name(common_name), key, authority.certificate.subject, CERTIFICATE_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
    names = [_general(host) for host in hosts or (common_name,)]
    builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    made = builder.sign(authority.key, hashes.SHA256())
    chain = pem(made) + (pem(authority.cross) if authority.cross else b"")
    return Issued(chain, key_pem(key))


def pem(certificate: x509.Certificate) -> bytes:
    """PEM of a certificate."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """PEM of a private key (PKCS 8, not encrypted)."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(oid.NameOID.COMMON_NAME, text)])


def _general(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _builder(
    subject: x509.Name, key: ec.EllipticCurvePrivateKey, issuer: x509.Name, days: int
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(now - EARLIER)
    return builder.not_valid_after(now + datetime.timedelta(days=days))


def _sign_authority(
    subject: x509.Name, key: ec.EllipticCurvePrivateKey, issuer: x509.Name, signs: ec.EllipticCurvePrivateKey
) -> x509.Certificate:
    builder = _builder(subject, key, issuer, AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    return builder.add_extension(usage, critical=True).sign(signs, hashes.SHA256())


EXAMPLE = "kilterd zenoh-config --out /etc/kilter/zenoh --host cell7.lab --controller left=arm1,arm2"
RECORD = "roles.json"


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    command.add_argument("--out", type=Path, help="folder to write (default: zenoh in the data folder)")
    command.add_argument(
        "--host",
        dest="hosts",
        metavar="HOST",
        action="append",
        default=[],
        help="name or address of the corrector's machine",
    )
    command.add_argument("--listen-port", type=int, default=7447, help="port of the corrector (default 7447)")
    command.add_argument(
        "--controller",
        action="append",
        default=[],
        metavar="NAME[=ROBOT,...]",
        help="a controller, and its robots only",
    )
    command.add_argument("--rotate", action="store_true", help="make a new authority and new certificates")
    command.add_argument("--certificate", type=Path, help="certificate of the corrector from elsewhere, with its chain")
    command.add_argument("--key", type=Path, help="its private key")
    command.add_argument("--authorities", type=Path, help="certificates of the authorities that signed it")


def write_role_folders(settings: Settings, given: argparse.Namespace) -> None:
    """Write zenoh configurations with TLS and access control, one folder per role, or rotate their certificates."""
    folder: Path = given.out or settings.data / "zenoh"
    roles = _roles(folder, given)
    authority, trusted = load_or_make_authority(folder, given.rotate)
    if given.authorities:
        trusted += given.authorities.read_bytes()
    written = write_folders(
        folder,
        settings.site,
        tuple(roles["hosts"]),
        roles["port"],
        {name: tuple(robots) for name, robots in roles["controllers"].items()},
        settings.ros2_domain,
        authority,
        trusted,
        _issued_from_arguments(given),
    )
    (folder / RECORD).write_text(json.dumps(roles, indent=1), encoding="utf-8")
    print(f"Copy each folder to its machine, and nothing of {folder / 'authority'}:")
    for place in written:
        print(f"  {place}")
    print(
        f"Then start the corrector with KILTER_ZENOH_CONFIG={folder / 'corrector' / 'zenoh.json5'} "
        f"KILTER_ZENOH_LISTEN=tls/0.0.0.0:{roles['port']}"
    )


def _roles(folder: Path, given: argparse.Namespace) -> dict[str, Any]:
    """What the options say, else what was written last time."""
    if given.hosts or given.controller or not (folder / RECORD).exists():
        controllers = dict(map(_parse_controller, given.controller or ["main"]))
        hosts = given.hosts or [socket.gethostname(), "localhost", "127.0.0.1"]
        return {"hosts": hosts, "port": given.listen_port, "controllers": controllers}
    roles: dict[str, Any] = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    return roles


def _parse_controller(text: str) -> tuple[str, list[str]]:
    name, _, robots = text.partition("=")
    names = [name, *(robots.split(",") if robots else [])]
    for one in names:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", one):
            raise ServiceError(
                f"--controller {text}: {one!r} is not a name; use 1 to 64 letters, digits, '_', '-' or '.', as in "
                "left=arm1,arm2.",
                code="option_invalid",
            )
    return name, names[1:] or ["*"]


def _issued_from_arguments(given: argparse.Namespace) -> Issued | None:
    files = (given.certificate, given.key, given.authorities)
    if not any(files):
        return None
    if not all(files):
        raise ServiceError("--certificate, --key and --authorities go together.", code="option_invalid")
    return Issued(given.certificate.read_bytes(), given.key.read_bytes())
