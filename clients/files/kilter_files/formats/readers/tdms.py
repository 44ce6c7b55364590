"""LabVIEW's TDMS files."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.tdms import channels, read_channel
from kilter_files.formats.tables.tdms_columns import read_tdms
from kilter_files.tables.source import Source

MOST_CHANNELS, MOST_SAMPLES = 64, 5_000_000  # of which the range is looked for


class Tdms(Reader[Source]):
    """Channels as columns."""

    name = "tdms"
    title = "LabVIEW's TDMS"
    use = MAP
    endings = (".tdms",)
    is_a = "a TDMS file"
    instead = "See what it holds with kilter inspect."

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
