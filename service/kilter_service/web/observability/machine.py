"""What the machine of the API says in numbers: room on the disk, end of the certificate, age of the newest backup."""

from __future__ import annotations

import contextlib
import math
import shutil
from collections.abc import Iterable
from pathlib import Path

from prometheus_client.core import GaugeMetricFamily, Metric

from kilter_service.ground.files import backup_folder
from kilter_service.ground.settings import Settings


def gauges(settings: Settings) -> Iterable[Metric]:
    """Give what can be read; what cannot is left out, so that an alert on its absence may say so."""
    free = GaugeMetricFamily("kilter_disk_free_bytes", "Bytes free on the disk of the data folder.")
    end = GaugeMetricFamily(
        "kilter_certificate_end_timestamp_seconds", "When the server's certificate ends, s since 1970."
    )
    age = GaugeMetricFamily("kilter_backup_age_seconds", "Since the newest backup in KILTER_BACKUPS; +Inf without any.")
    with contextlib.suppress(OSError):
        free.add_metric((), float(shutil.disk_usage(settings.data).free))
    moment = _certificate_end_s(settings)
    if moment is not None:
        end.add_metric((), moment)
    if settings.backups is not None:
        age.add_metric((), _backup_age_s(settings.backups))
    return free, end, age


def _backup_age_s(folder: Path) -> float:
    """Age of the newest backup; infinite where there is none, or none that can be seen."""
    try:
        found = backup_folder.backups(folder)
    except OSError:
        return math.inf
    return found[0].age_s() if found else math.inf


def _certificate_end_s(settings: Settings) -> float | None:
    """End of the first certificate of the file, which is the server's own; None without one that can be read."""
    if settings.tls_certificate is None:
        return None
    from cryptography import x509

    try:
        certificate = x509.load_pem_x509_certificate(settings.tls_certificate.read_bytes())
    except (OSError, ValueError):
        return None
    return certificate.not_valid_after_utc.timestamp()
