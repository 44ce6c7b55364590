"""LabVIEW's TDMS files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.tdms import Channel, channels, read_channel
from kilter_files.ground.errors import fault
from kilter_files.tables.source import Source


@dataclass
class TdmsSource:
    """A TDMS file whose columns are its channels, ``group/channel``. Samples are numbered from 1."""

    path: Path
    found: list[Channel]
    missing: tuple[float, ...] = ()

    @property
    def names(self) -> list[str]:
        """The channels."""
        return [channel.name for channel in self.found]

    @property
    def lines(self) -> list[int]:
        """Samples have no lines; the rows are numbered by whoever asks."""
        return []

    @property
    def choices(self) -> list[str]:
        """What ``from`` may name."""
        return self.names

    def texts(self, name: str | int) -> list[str]:
        """Return a channel as text, for row filters."""
        return [repr(value) for value in self.numbers(name)]

    def numbers(self, name: str | int) -> list[float]:
        """Return a channel's scaled values, NaN for those that stand for "missing".

        Raises:
            FileError: no such channel, or one of text.

        """
        if isinstance(name, int):
            if not 0 <= name < len(self.found):
                raise fault(self.path, f"has no channel {name}", f"It has {', '.join(self.names)}.")
            name = self.names[name]
        gone = set(self.missing)
        values = read_channel(self.path, name)[1].tolist()
        return [float("nan") if value in gone else value for value in values]


def read_tdms(path: Path, missing: tuple[float, ...] = ()) -> TdmsSource:
    """Read a TDMS file with npTDMS.

    Raises:
        FileError: no TDMS file, or a damaged one.

    """
    return TdmsSource(path, channels(path), missing)


MOST_CHANNELS, MOST_SAMPLES = 64, 5_000_000  # of which the range is looked for


class Tdms(Reader[Source]):
    """Channels as columns."""

    name = "tdms"
    title = "LabVIEW's TDMS"
    use = MAP
    endings = (".tdms",)
    is_a = "a TDMS file"
    instead = "See what it holds with kilter measure inspect."

    def recognises(self, head: Head) -> bool:
        """The first four bytes."""
        return head.start.startswith(b"TDSm")

    def describe(self, head: Head) -> Document:
        """Channels with their rates, units and ranges."""
        out: list[Document] = []
        for channel in channels(head.path):
            about: Document = {
                "name": channel.name,
                "samples": channel.samples,
                "unit": channel.unit,
                "rate_hz": None if channel.step_s is None else 1 / channel.step_s,
                "scaled": channel.scaled,
            }
            if 0 < channel.samples <= MOST_SAMPLES and len(out) < MOST_CHANNELS:
                values = read_channel(head.path, channel.name)[1]
                about |= {"low": float(values.min()), "high": float(values.max())}
            out.append(about)
        return {"channels": out}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the channels."""
        return read_tdms(path, hints.layout.missing_numbers)


READER = Tdms()
