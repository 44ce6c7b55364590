"""How kernels are compiled, and where the compiled code is kept: in a folder for each state of all kernel sources.

numba keeps what it compiled until the file of the function changes. It does not see a change of a function in another
file that this one calls, and goes on with the old one. Here the folder is named after a digest of every kernel source
and of the function's own file, so a change of any of them compiles anew, and folders of older digests are removed.
The folder lies where numba would keep its files: in NUMBA_CACHE_DIR where that is set, else in ``__pycache__`` beside
the source, else, where that is not writable, in the user's cache. What lies beside the source is read wherever else new
files go: an administrator compiles once for every user. Nothing is compiled, looked for or made at import.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import shutil
import sys
import uuid
import warnings
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core import serialize
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import _nrt_python  # type: ignore[attr-defined]
from numba.core.runtime.nrt import ll  # type: ignore[attr-defined]  # llvmlite

# UNCOUNTED: references to arrays are not counted, for functions that make none. Arrays outlive every call, and counting
# those that are handed on takes a third of the time of a correction, and half of that of a load.
# EXACT: no sum is contracted or rearranged. That would save a sixth of the time of a correction; but near a singular posture
# what is rounded otherwise grows a thousandfold, and so the C corrector answers as the kernels do to the last bit.
UNCOUNTED: dict[str, Any] = {"_nrt": False}
EXACT: dict[str, Any] = {**UNCOUNTED, "error_model": "numpy"}


def compile_kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function by numba with these options, at its first call, and keep the result on disk."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(**options)(function)
        if isinstance(dispatcher, Dispatcher):  # else NUMBA_DISABLE_JIT is set
            # What numba's cache=True does, but that makes folders at import.
            dispatcher._cache = KernelCache(function, options.get("_nrt", True))  # type: ignore[attr-defined]
        return dispatcher

    return decorate


@cache
def _sources() -> bytes:
    """Digest of all kernel sources, taken once and early: what is compiled later is what was imported now."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[2]
    for source in sorted(package.glob("*/kernels/*.py")):
        digest.update(str(source.relative_to(package)).encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.digest()


@cache
def _digest(source: str) -> str:
    """Digest of all kernel sources and of this file, as it stands in the name of a folder."""
    return hashlib.sha256(_sources() + Path(source).read_bytes()).hexdigest()[:16]


@cache
def _warn(place: str) -> None:
    warnings.warn(
        f"Compiled kernels cannot be kept, so every start compiles them anew, for a minute or two: neither {place} nor "
        "the user's cache folder is writable. Set NUMBA_CACHE_DIR to a folder that is.",
        RuntimeWarning,
        stacklevel=2,
    )


class KernelCache(FunctionCache):
    """The compiled forms of one function: a file for each signature.

    numba keeps an index of these files for each function. Two processes that start at once can overwrite each other's
    index, and then a signature may lead to the code of another; here the name of the file says all that the index did.
    """

    def __init__(self, function: Callable[..., Any], counts_references: bool) -> None:
        self._py_func, self._counts_references = function, counts_references
        self._name = repr(function)
        self._source = function.__code__.co_filename
        self._folder_name = f"{Path(self._source).stem}-{_digest(self._source)}.kernels"
        self.enable()

    @cached_property
    def _impl(self) -> Any:
        return self._impl_class(self._py_func)  # looks for a folder that is writable

    @cached_property
    def _folder(self) -> Path | None:
        try:
            return Path(self._impl.locator.get_cache_path()) / self._folder_name
        except RuntimeError:  # no folder is writable
            _warn(str(Path(self._source).parent))
            return None

    @property
    def cache_path(self) -> str | None:
        """The folder, None where nothing is kept."""
        return None if self._folder is None else str(self._folder)

    def flush(self) -> None:
        """Forget every compiled form of the function."""
        for file in self._folder.glob(f"{self._stem}-*.nbc") if self._folder else ():
            file.unlink(missing_ok=True)

    @property
    def _stem(self) -> str:
        return str(self._py_func.__qualname__).replace("<locals>.", "")

    @property
    def _pycache_folder(self) -> Path:
        return Path(self._source).parent / "__pycache__" / self._folder_name

    @property
    def is_on_disk(self) -> bool:
        """Whether a form of the function, of today's sources, lies where it is looked for."""
        return any(any(folder.glob(f"{self._stem}-*.nbc")) for folder in (self._folder, self._pycache_folder) if folder)

    def _file_name(self, signature: Any, codegen: Any) -> str:
        """Name of the file of a signature: after the types, the processor and the versions."""
        types, *rest = self._index_key(signature, codegen)
        key = repr((numba.__version__, sys.version_info[:2], str(types), *rest))
        return f"{self._stem}-{hashlib.sha256(key.encode()).hexdigest()[:24]}.nbc"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled form without what only compiling needs: numba loads that first, 50 MB and half a second."""
        if self._counts_references:
            _register_runtime()
        return self._load_overload(sig, target_context)

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        name = self._file_name(sig, target_context.codegen())
        for folder in (self._folder, self._pycache_folder) if self._enabled else ():
            # Written by this user, or by whoever wrote the sources, where nobody else writes: what a .pyc is for Python.
            # Not there yet, or a machine went down while it wrote: then the next place, or compiled anew.
            with contextlib.suppress(OSError, EOFError, pickle.UnpicklingError):
                if folder is not None:
                    kept = pickle.loads((folder / name).read_bytes())  # noqa: S301
                    # Not of the instance: that needs a folder to write in.
                    return self._impl_class.rebuild(self, target_context, kept)  # type: ignore[no-untyped-call,arg-type]
        return None

    def _save_overload(self, sig: Any, data: Any) -> None:
        if not self._enabled or self._folder is None or not self._impl.check_cachable(data):
            return
        file = self._folder / self._file_name(sig, data.codegen)
        with contextlib.suppress(OSError):  # a full disk: the function works all the same
            _write(file, serialize.dumps(self._impl.reduce(data)))  # type: ignore[no-untyped-call]
            _remove_older(file.parent)


@cache
def _register_runtime() -> None:
    """Tell LLVM where numba's functions for arrays are, which a kernel that makes arrays calls."""
    for name, address in _nrt_python.c_helpers.items():
        ll.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


def _write(file: Path, content: bytes) -> None:
    """Write a file at once, for others may be reading it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f"{uuid.uuid4().hex}.part")
    try:
        part.write_bytes(content)
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


@cache
def _remove_older(folder: Path) -> None:
    """Remove what older digests left of the same source file."""
    stem = folder.name.rpartition("-")[0]
    for other in folder.parent.glob(f"{stem}-*.kernels"):
        if other != folder:
            shutil.rmtree(other, ignore_errors=True)
