"""The C corrector, compiled and called through ctypes."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kilter_core.correct.file import to_bytes
from kilter_core.correct.program import CorrectionProgram

Floats = NDArray[np.float64]
FOLDER = Path(__file__).resolve().parents[3] / "clients" / "c"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
CPP = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror")


class Answer(ctypes.Structure):
    """kc_answer."""

    _fields_ = (
        ("status", ctypes.c_int), ("flags", ctypes.c_uint), ("limit_mask", ctypes.c_uint), ("rounds", ctypes.c_int),
        ("left_m", ctypes.c_double * 3), ("left_rad", ctypes.c_double), ("left", ctypes.c_double),
        ("without_m", ctypes.c_double * 3),
    )  # fmt: skip


class State(ctypes.Structure):
    """kilter_corrector."""

    _fields_ = (
        ("version", ctypes.c_char * 41), ("robot", ctypes.c_char * 65), ("number", ctypes.c_uint64),
        ("joints", ctypes.c_int), ("rows", ctypes.c_int), ("moves", ctypes.c_int), ("memory", ctypes.c_void_p),
        ("setpoint", ctypes.c_double * 48),
    )  # fmt: skip


def built(folder: Path, *options: str) -> ctypes.CDLL:
    """The library, compiled into a folder."""
    made = folder / "kilter_corrector.so"
    source = str(FOLDER / "kilter_corrector.c")
    command = [str(COMPILER), *WARNINGS, "-O2", "-shared", "-fPIC", *options, "-o", str(made), source, "-lm"]
    subprocess.run(command, check=True)
    library = ctypes.CDLL(str(made))
    library.kc_memory_needed.restype = ctypes.c_size_t
    library.kc_sentence.restype = ctypes.c_char_p
    return library


class Corrector:
    """One corrector with the memory it works in."""

    def __init__(self, library: ctypes.CDLL, blob: bytes, *, settled: bool = False) -> None:
        self.library, self.state = library, State()
        self.memory = self._fresh(blob)
        self.loaded = library.kc_load(
            ctypes.byref(self.state), blob, ctypes.c_size_t(len(blob)), *self.memory[:2], int(settled)
        )

    def _fresh(self, blob: bytes) -> tuple[ctypes.c_void_p, ctypes.c_size_t, Floats]:
        doubles = int(self.library.kc_memory_needed(blob, ctypes.c_size_t(len(blob))))
        memory = np.full(doubles, np.nan)
        return ctypes.c_void_p(memory.ctypes.data), ctypes.c_size_t(doubles), memory

    def change(self, blob: bytes) -> int:
        """Go on with another version."""
        memory = self._fresh(blob)
        code = int(
            self.library.kc_change(ctypes.byref(self.state), blob, ctypes.c_size_t(len(blob)), memory[0], memory[1])
        )
        if code == 0:
            self.memory = memory
        return code

    def correct(self, q: Floats, dt: float, *motion: Floats) -> tuple[int, Floats, Answer]:
        """Correct one setpoint of a stream."""
        out, answer = np.empty(len(q)), Answer()
        vectors = [_pointer(v) for v in (q, *motion)] + [None] * (2 - len(motion))
        call = (ctypes.byref(self.state), *vectors, ctypes.c_double(dt), _pointer(out), ctypes.byref(answer))
        return int(self.library.kc_correct(*call)), out, answer

    def correct_alone(self, q: Floats, direction: Floats, *motion: Floats) -> tuple[int, Floats, Answer]:
        """Correct a setpoint that follows no other."""
        out, answer = np.empty(len(q)), Answer()
        vectors = [_pointer(v) for v in (q, *motion)] + [None] * (2 - len(motion))
        call = (ctypes.byref(self.state), *vectors, _pointer(direction), _pointer(out), ctypes.byref(answer))
        return int(self.library.kc_correct_alone(*call)), out, answer


def _pointer(numbers: Floats) -> ctypes.c_void_p:
    return ctypes.c_void_p(numbers.ctypes.data)


def blob_of(program: CorrectionProgram, robot: str = "arm", version_id: str = "ver_1", number: int = 1) -> bytes:
    """A program as a file."""
    return to_bytes(program, version_id=version_id, number=number, robot=robot)
