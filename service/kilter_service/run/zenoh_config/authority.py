"""A certificate authority of one's own, and certificates for the roles of the stream.

At a rotation the new authority is also signed by the one before. This cross certificate goes with every new certificate, so
whoever trusts only the old authority accepts new certificates as well: nothing has to be restarted or copied at once.
"""

from __future__ import annotations

import datetime
import ipaddress
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

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
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if hosts else [])]
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
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


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
