"""The low-cost rig: TDMS channels, volts to mm, inclinometers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsFile, TdmsWriter

from kilter_client import FileError
from kilter_files.formats.instrument_logs import read_inclinometer
from kilter_files.formats.tables.tdms import Calibration, channels, read_channel


def write_tdms(path: Path, volts: np.ndarray, step: float = 0.001) -> Path:
    with TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [ChannelObject("rig", "poti", volts, properties={"wf_increment": step, "unit_string": "V"})]
        )
    return path


def test_daqmx_scaling_is_applied(shared_data: Path) -> None:
    path = shared_data / "tdms-samples/raw1.tdms"
    found = channels(path)
    assert len(found) == 7
    assert found[0].scaled
    with TdmsFile.open(path) as file:
        raw = file["Layer Data"]["First  Channel"].read_data(scaled=False)
    counts = np.asarray(next(iter(raw.values())) if isinstance(raw, dict) else raw, dtype=float)
    t, values = read_channel(path, found[0].name)
    assert len(values) == 2000
    assert t[1] == pytest.approx(2e-5)
    slope, offset = np.polyfit(counts, values, 1)
    assert slope == pytest.approx(3.05e-4, rel=0.01)
    np.testing.assert_allclose(values, slope * counts + offset, atol=1e-9)


def test_big_endian_and_digital(shared_data: Path) -> None:
    found = channels(shared_data / "tdms-samples/big_endian.tdms")
    assert [(c.samples, c.step_s) for c in found] == [(3500, 0.001)] * 2
    _, values = read_channel(shared_data / "tdms-samples/big_endian.tdms", found[0].name)
    assert abs(values).max() == pytest.approx(6.0, abs=0.01)
    assert channels(shared_data / "tdms-samples/Digital_Input.tdms")[0].samples == 20_000


def test_volts_to_mm(tmp_path: Path) -> None:
    path = write_tdms(tmp_path / "a.tdms", np.array([0.0, 1.0, 2.5, 5.0, 5.2]))
    _, volts = read_channel(path, "rig/poti")
    np.testing.assert_allclose(Calibration(((0, -10), (2.5, 15), (5, 35))).to_mm(volts), [-10, 0, 15, 35, 36.6])
    np.testing.assert_array_equal(
        np.isnan(Calibration(((0, 0), (1, 10))).to_mm(volts)), [False, False, True, True, True]
    )
    with pytest.raises(FileError, match=r"did you mean 'rig/poti'"):
        read_channel(path, "rig/pot")


def test_bad_tdms(tmp_path: Path) -> None:
    path = write_tdms(tmp_path / "a.tdms", np.arange(1000.0))
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])
    with pytest.raises(FileError, match="byte 0: is cut off"):
        channels(path)
    path.write_bytes(b"XXXX" + whole[4:])
    with pytest.raises(FileError, match="is not a TDMS file"):
        channels(path)
    path.write_bytes(whole + b"rubbish")
    with pytest.raises(FileError, match="does not begin where the one before ends"):
        channels(path)


def test_inclinometer(tmp_path: Path) -> None:
    path = tmp_path / "tilt.csv"
    path.write_text("Time [ms];Incl X [mm/m];Incl Y [mm/m]\n100;1,0;0\n200;2,0;-1\n")
    found = read_inclinometer(path)
    np.testing.assert_allclose(found.columns["t_s"], [0, 0.1])
    np.testing.assert_allclose(found.columns["tilt_x_deg"], np.degrees([1e-3, 2e-3]))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,tilt\n0,1\n1,2\n", "no stated unit. Give the unit"),
        ("t,tilt [rad]\n0,0.1\n1,90\n", r"line 3, column 'tilt': more than 180 degrees, declared as rad"),
        ("t,tilt [deg]\n0,1\n1,2\n0.5,2\n", r"line 4, column 't': time goes back: two logs concatenated"),
        ("t,tilt [deg]\n0,1\n1,\n2,1\n", "line 3: (1 cells|a cell is empty)"),
    ],
)
def test_bad_inclinometer(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(FileError, match=words):
        read_inclinometer(tmp_path / "a.csv")
