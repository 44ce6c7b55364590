"""The admin token, made at first start and kept in a file only its owner can read; where a server listens by it."""

from __future__ import annotations

import os
import secrets
import ssl
import stat

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings, check_strong


def admin_token(settings: Settings) -> str:
    """Return the token that changes need; the first start of a data folder makes it (mode 0600).

    Raises:
        ServiceError: the token file can be read by others, or holds a token that can be guessed.

    """
    if settings.token is not None:
        return settings.token.get_secret_value()
    settings.data.mkdir(parents=True, exist_ok=True)
    # Two processes may start at once: whoever links the finished file first wins, the other reads it.
    if not settings.token_file.exists():
        _offer(settings)
    if stat.S_IMODE(settings.token_file.stat().st_mode) & 0o077:
        raise ServiceError(
            f"{settings.token_file} can be read by others: run `chmod 600 {settings.token_file}`.",
            code="token_file_open",
            path=str(settings.token_file),
        )
    token = settings.token_file.read_text(encoding="ascii", errors="replace").strip()
    try:
        check_strong(token)
    except ValueError as error:
        raise ServiceError(
            f"In {settings.token_file} {error}, or delete the file: the next start makes a new one.",
            code="token_weak",
            path=str(settings.token_file),
        ) from error
    return token


def _offer(settings: Settings) -> None:
    draft = settings.token_file.with_name(f"{settings.token_file.name}.{os.getpid()}")
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="ascii") as file:
        file.write(secrets.token_urlsafe(32) + "\n")
    try:
        os.link(draft, settings.token_file)
    except FileExistsError:
        return
    finally:
        draft.unlink()


def check_binding(settings: Settings) -> None:
    """Refuse to listen beyond this machine without a token, or without TLS.

    Raises:
        ServiceError: so, or a certificate that cannot be used.

    """
    check_certificate(settings)
    if settings.is_loopback:
        return
    if settings.token is None and not settings.token_file.exists():
        raise _binding_error(settings, "no token is configured: set KILTER_TOKEN, or listen on 127.0.0.1")
    if settings.tls_certificate is None and not settings.proxy:
        raise _binding_error(
            settings,
            "tokens would travel in the clear: set KILTER_TLS_CERTIFICATE and KILTER_TLS_KEY, or put a proxy with TLS in "
            "front and set KILTER_PROXY to its address, or listen on 127.0.0.1",
        )


def _binding_error(settings: Settings, why: str) -> ServiceError:
    return ServiceError(
        f"{settings.host} can be reached from other machines and {why}.", code="binding_refused", host=settings.host
    )


def check_certificate(settings: Settings) -> None:
    """Refuse a certificate without its key, or one that cannot be read.

    Raises:
        ServiceError: so.

    """
    if settings.tls_certificate is None and settings.tls_key is None:
        return
    if settings.tls_certificate is None or settings.tls_key is None:
        raise ServiceError("Set both KILTER_TLS_CERTIFICATE and KILTER_TLS_KEY, or neither.", code="binding_refused")
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(settings.tls_certificate, settings.tls_key)
    except (OSError, ssl.SSLError) as error:
        raise ServiceError(
            f"{settings.tls_certificate} and {settings.tls_key} cannot be used for TLS ({error}): give the PEM files of "
            "a certificate and of its key, without a password, readable by this account.",
            code="binding_refused",
        ) from error
