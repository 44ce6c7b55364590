"""A version as a file of another program."""

from __future__ import annotations


class Exported(bytes):
    """A version as bytes of a file; ``notes`` are what the file leaves out, and what else the server says of it."""

    notes: tuple[str, ...] = ()
