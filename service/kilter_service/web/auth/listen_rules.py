"""Where a server may listen: beyond this machine only with a token, and only where nobody can read it on the way."""

from __future__ import annotations

import ssl

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings


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
