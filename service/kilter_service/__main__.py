"""`kilterd`, where it can run; elsewhere one sentence says so."""

from __future__ import annotations

import sys
from collections.abc import Sequence

ELSEWHERE = (
    "kilterd: the server needs Linux: on this system Python lacks {}, by which its processes lock their files. On Windows run "
    "it in WSL 2 or in a container; the kilter command and library run here and reach it over the network."
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; exits 0 when it is done, 1 when it failed, 2 when it was called wrongly."""
    try:
        import fcntl  # noqa: F401
    except ImportError as error:
        print(ELSEWHERE.format(error.name or "fcntl"), file=sys.stderr)
        sys.exit(1)
    from kilter_service.run.program import main as run

    run(arguments)


if __name__ == "__main__":
    main()
