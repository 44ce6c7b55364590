"""Every key expression of the stream in one place.

``@v1`` is a verbatim chunk: no wildcard matches it, so a peer of another version never sees these messages.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

PREFIX = "kilter/@v1"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def validate_chunk(name: str, what: str) -> str:
    """Return ``name`` when it can be one chunk of a key, else raise ValueError naming the rule."""
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"{what} {name!r} cannot be part of a stream key: use 1 to 64 letters, digits, '_', '-' or '.', "
            "starting with a letter or digit."
        )
    return name


@dataclass(frozen=True)
class RobotKeys:
    """Keys of one robot at one site."""

    site: str
    robot: str

    def __post_init__(self) -> None:
        validate_chunk(self.site, "site")
        validate_chunk(self.robot, "robot")

    @property
    def root(self) -> str:
        """Prefix of all keys of the robot."""
        return f"{PREFIX}/{self.site}/{self.robot}"

    @property
    def active(self) -> str:
        """Where the version in use is announced, on change and on request."""
        return f"{self.root}/active"

    @property
    def correct(self) -> str:
        """Query: a whole trajectory."""
        return f"{self.root}/@rpc/correct"

    @property
    def describe(self) -> str:
        """Query: what the stream expects and does."""
        return f"{self.root}/@rpc/describe"

    def alive(self, instance: str) -> str:
        """Liveliness token of the corrector process ``instance`` for this robot."""
        return f"{self.root}/@alive/{validate_chunk(instance, 'instance')}"

    def stream(self, stream: str, part: str) -> str:
        """Key of one part (``in``, ``out``, ``status`` or ``live``) of a stream."""
        return f"{self.root}/stream/{validate_chunk(stream, 'stream')}/{part}"


def every_input(site: str) -> str:
    """Key expression of the setpoints of all robots and streams of a site."""
    return f"{PREFIX}/{validate_chunk(site, 'site')}/*/stream/*/in"


def every_live(site: str) -> str:
    """Key expression of what people may look at, of all robots and streams of a site."""
    return f"{PREFIX}/{validate_chunk(site, 'site')}/*/stream/*/live"


def every_query(site: str, procedure: str) -> str:
    """Key expression of one procedure (``correct`` or ``describe``) of all robots of a site."""
    return f"{PREFIX}/{validate_chunk(site, 'site')}/*/@rpc/{procedure}"


def every_active(site: str) -> str:
    """Key expression of the version announcements of all robots of a site."""
    return f"{PREFIX}/{validate_chunk(site, 'site')}/*/active"


def robot_from_key(key: str) -> str:
    """Robot named by a key of this module.

    Raises:
        ValueError: not such a key.

    """
    parts = key.split("/")
    if len(parts) < 5 or parts[0] != "kilter" or parts[1] != "@v1":
        raise ValueError(f"{key!r} is not a key of the stream")
    return parts[3]


def stream_from_key(key: str) -> str:
    """Stream named by a key of a stream's direction.

    Raises:
        ValueError: not such a key.

    """
    parts = key.split("/")
    if len(parts) != 7 or parts[4] != "stream":
        raise ValueError(f"{key!r} is not the key of a stream")
    return parts[5]
