"""`kilterd doctor` as a command."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict

from kilter_service.ground.settings import Settings
from kilter_service.run.doctor.checks import run


def doctor(settings: Settings, arguments: argparse.Namespace) -> None:
    """Print the checks; ends with 1 when one of them failed."""
    found = run(settings)
    wrong = [check for check in found if not check.ok]
    if arguments.json:
        print(json.dumps({"ok": not wrong, "checks": [asdict(check) for check in found]}, indent=1))
    else:
        for check in found:
            print(f"{'ok   ' if check.ok else 'WRONG'} {check.name}: {check.detail.rstrip('.')}.")
    if wrong:
        sys.exit(1)
