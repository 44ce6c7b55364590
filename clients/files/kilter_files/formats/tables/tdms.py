"""National Instruments TDMS files, with the scaling they state, and volts to mm by a calibration."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import did_you_mean, fault
from kilter_files.ground.later import need, np

LEAD_IN = struct.Struct("<4sIIQQ")
INCOMPLETE = 0xFFFF_FFFF_FFFF_FFFF
MOST_SEGMENTS = 1_000_000
BIG_ENDIAN = 0x40
LEAST_BYTES = 1 / 8  # a sample takes at least a bit
AGAIN = "Copy it again, or open and save it in LabVIEW or DIAdem."


@dataclass(frozen=True)
class Channel:
    """One channel: its name ``group/channel``, samples, unit, and the step of its time, None where it has none."""

    name: str
    samples: int
    unit: str
    step_s: float | None
    scaled: bool


@dataclass(frozen=True)
class Calibration:
    """Volts to mm by points measured with a gauge block: straight lines between two or more (V, mm)."""

    points: tuple[tuple[float, float], ...]

    def to_mm(self, volts: Floats) -> Floats:
        """Return lengths in mm, NaN outside the calibrated range by more than a tenth of it."""
        v, mm = np.array(sorted(self.points)).T
        margin = 0.1 * (v[-1] - v[0])
        slope = [np.diff(mm)[0] / np.diff(v)[0], np.diff(mm)[-1] / np.diff(v)[-1]]
        inner = np.interp(volts, v, mm)
        inner = np.where(volts < v[0], mm[0] + (volts - v[0]) * slope[0], inner)
        inner = np.where(volts > v[-1], mm[-1] + (volts - v[-1]) * slope[1], inner)
        return np.where((volts < v[0] - margin) | (volts > v[-1] + margin), np.nan, inner)


def channels(path: Path) -> list[Channel]:
    """List the channels of a file.

    Raises:
        FileError: no TDMS file, or one that is cut off.

    """
    with _open_channels(path) as found:
        return [_describe_channel(channel) for channel in found]


def read_channel(path: Path, name: str) -> tuple[Floats, Floats]:
    """Return time [s] and the scaled values of a channel.

    Raises:
        FileError: no such channel, or text in it.

    """
    with _open_channels(path) as found:
        names = [_full(channel) for channel in found]
        if name not in names:
            remedy = f"It has {', '.join(names)}."
            raise fault(path, f"no channel {name!r}{did_you_mean(name, names)}", remedy, column=name)
        channel = found[names.index(name)]
        raw, step = _call_translating_errors(path, lambda: channel[:]), _describe_channel(channel).step_s
    if raw.dtype.kind not in "iufb":
        raise fault(path, f"holds {raw.dtype}, not numbers", "Choose a channel of voltages.", column=name)
    values = np.asarray(raw, dtype=np.float64)
    return np.arange(len(values), dtype=np.float64) * float(step or 1.0), values


@contextmanager
def _open_channels(path: Path) -> Iterator[list[Any]]:
    """Open a file whose segments were checked, for as long as its channels are read."""
    _walk(path)
    nptdms = need(f"{path}: TDMS files need", "npTDMS", "nptdms")
    size = path.stat().st_size
    with path.open("rb") as stream:
        file = _call_translating_errors(path, lambda: nptdms.TdmsFile.open(stream))
        found = _call_translating_errors(
            path, lambda: [channel for group in file.groups() for channel in group.channels()]
        )
        for channel in found:
            if len(channel) * LEAST_BYTES > size:
                what = f"claims {len(channel)} samples in {size} bytes"
                raise fault(path, what, AGAIN, column=_full(channel))
        yield found


def _call_translating_errors(path: Path, read: Callable[[], Any]) -> Any:
    """Run a call of the library; whatever it stumbles over in a damaged file is that file's fault."""
    try:
        return read()
    except MemoryError as error:
        raise fault(path, "claims more data than fits into memory", AGAIN) from error
    except Exception as error:  # npTDMS lets KeyError, struct.error, ValueError and more through
        what = f"is damaged: {type(error).__name__} {str(error)[:120]}"
        raise fault(path, what, AGAIN) from error


def _walk(path: Path) -> None:
    """Follow the segments from the first to the end, before a library trusts their numbers."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        at = 0
        for _ in range(MOST_SEGMENTS):
            stream.seek(at)
            lead = stream.read(LEAD_IN.size)
            if not lead and at:
                return
            if len(lead) < LEAD_IN.size or lead[:4] != b"TDSm":
                what = "is not a TDMS file" if at == 0 else "a segment does not begin where the one before ends"
                raise fault(path, what, AGAIN, byte=at)
            _, contents, _, after, raw = LEAD_IN.unpack(lead)
            if contents & BIG_ENDIAN:
                after, raw = struct.unpack_from(">QQ", lead, 12)
            if after == INCOMPLETE or at + LEAD_IN.size + after > size:
                raise fault(path, f"is cut off: its last segment states {after} bytes", AGAIN, byte=at)
            if raw > after:
                raise fault(path, "its data would start behind its end", AGAIN, byte=at)
            at += LEAD_IN.size + after
    raise fault(path, f"has more than {MOST_SEGMENTS} segments", "Open and save it in DIAdem, which joins them.")


def _full(channel: Any) -> str:
    return f"{channel.group_name}/{channel.name}"


def _describe_channel(channel: Any) -> Channel:
    properties = channel.properties
    step = properties.get("wf_increment")
    scaled = any(str(name).startswith(("NI_Scale[", "NI_Number_Of_Scales")) for name in properties)
    unit = str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "")
    good = isinstance(step, float | int) and 0 < float(step) < 1e6
    return Channel(_full(channel), len(channel), unit, float(step) if good and step is not None else None, scaled)
