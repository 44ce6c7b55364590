"""How the API process gives memory back, and how seldom it stops to look for garbage."""

from __future__ import annotations

import ctypes
import gc
import mmap
import os
import sys
import time
from contextlib import suppress
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any

# Of <malloc.h>. Every thread that works on a body would get an arena of its own, up to eight for each core, and what is
# freed in one is of no use to the others: forty threads kept as much as all bodies that they ever held at once.
M_ARENA_MAX, ARENAS = -8, 2
# malloc would raise both by itself, up to 64 MB, after the first large body; what is freed then stays in the process.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, LARGE_BYTES = -1, -3, 128 << 10
MADV_DONTNEED, PT_LOAD, PF_W, LARGE_SEGMENT_BYTES = 4, 1, 2, 1 << 20  # of <sys/mman.h> and <elf.h>
ARROW_POOL = "ARROW_DEFAULT_MEMORY_POOL"
LONG_PAUSE_S = 0.01


def keep_small() -> None:
    """Let threads share their memory; to be called before they start. Does nothing where the system has no such setting."""
    # Arrow's own allocator keeps what it had for itself, beside malloc's.
    os.environ.setdefault(ARROW_POOL, "system")
    sys.meta_path.insert(0, WithoutUnused())
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):
        return
    for setting, value in ((M_ARENA_MAX, ARENAS), (M_TRIM_THRESHOLD, LARGE_BYTES), (M_MMAP_THRESHOLD, LARGE_BYTES)):
        mallopt(setting, value)


def return_freed_memory() -> None:
    """Give the memory of work that is over back to the system: the C library would keep it for the next."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


class _Segment(ctypes.Structure):
    """``Elf64_Phdr`` of <elf.h>."""

    _fields_ = (
        *((name, ctypes.c_uint32) for name in ("kind", "flags")),
        *((name, ctypes.c_uint64) for name in ("offset", "address", "physical", "in_file", "size", "alignment")),
    )


class _Library(ctypes.Structure):
    """The beginning of ``struct dl_phdr_info`` of <link.h>."""

    _fields_ = (
        ("address", ctypes.c_uint64),
        ("name", ctypes.c_char_p),
        ("segments", ctypes.POINTER(_Segment)),
        ("count", ctypes.c_uint16),
    )


def return_pages_of_libraries() -> None:
    """Give back what was only read of compiled libraries: to load LLVM visits 40 MB of it, most of it once.

    What is needed again is read again, from the system's cache of files. Nothing is written to these segments, so nothing
    is lost. The loader names them: a list of mappings may be of a library that another thread is just loading.
    """
    if sys.platform != "linux" or sys.maxsize < 1 << 32:
        return
    library = ctypes.PyDLL(None)  # keeps Python's lock: the loader's is held while its libraries are named
    if not (hasattr(library, "dl_iterate_phdr") and hasattr(library, "madvise")):
        return

    def return_segments(found: Any, size: int, nothing: int | None) -> int:
        one = found.contents
        for segment in one.segments[: one.count]:
            if segment.kind == PT_LOAD and not segment.flags & PF_W and segment.size >= LARGE_SEGMENT_BYTES:
                first = one.address + segment.address
                begin = first - first % mmap.PAGESIZE
                library.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(first + segment.size - begin), MADV_DONTNEED)
        return 0

    visitor = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.POINTER(_Library), ctypes.c_size_t, ctypes.c_void_p)
    library.dl_iterate_phdr(visitor(return_segments), None)


def set_out_of_memory_score(score: int) -> None:
    """Have the kernel end this process before those with a lower score (0 to 1000) where memory is used up."""
    with suppress(OSError):  # another system than Linux
        Path("/proc/self/oom_score_adj").write_text(str(score), encoding="ascii")


# Arrow imports pandas, 50 MB, where it is installed, to ask whether an array is one of its, and storages in clouds, 3 MB;
# numpy imports what guesses the encoding of Fortran, 3 MB.
UNUSED = frozenset(
    {"charset_normalizer", "coverage", "pandas", "pyarrow._azurefs", "pyarrow._gcsfs", "pyarrow._hdfs", "pyarrow._s3fs"}
)


class WithoutUnused(MetaPathFinder):
    """Hides what other packages import if it is there, and Kilter has no use for."""

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> None:
        """Refuse to find them, and leave the rest to others.

        Raises:
            ModuleNotFoundError: one of them is asked for.

        """
        if fullname in UNUSED:
            raise ModuleNotFoundError(f"{fullname} is not used here", name=fullname)


class ShortPauses:
    """Keeps collections of garbage short: what a long one left is not looked through again.

    Modules that are imported when they are first needed, and the caches that fill up then, made every full collection
    stop all requests for 0.1 s. What is freed by its count of references is freed as before.
    """

    def __init__(self, long_s: float = LONG_PAUSE_S) -> None:
        self._long_s, self._began = long_s, 0.0

    def watch_collections(self) -> None:
        """Watch the collections of this process from now on."""
        gc.callbacks.append(self._freeze_after_slow_collection)

    def _freeze_after_slow_collection(self, phase: str, info: dict[str, int]) -> None:
        if info["generation"] < 2:
            return
        if phase == "start":
            self._began = time.perf_counter()
        elif time.perf_counter() - self._began > self._long_s:
            gc.freeze()
            return_pages_of_libraries()
