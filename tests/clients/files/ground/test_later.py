"""Packages that are imported at their first use."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

from kilter_files.ground import later
from kilter_files.ground.errors import MissingPackageError


@pytest.mark.parametrize("name", [name for name, it in vars(later).items() if isinstance(it, later.Later)])
def test_every_package_of_the_gate_is_one_that_is_imported_at_its_first_use(name: str) -> None:
    code = f"import sys; from kilter_files.ground.later import {name} as it; print(it._name in sys.modules, it._name)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded, module = done.stdout.split()
    assert loaded == "False"
    first = next(one for one in dir(import_module(module)) if not one.startswith("_"))
    assert getattr(getattr(later, name), first) is getattr(import_module(module), first)


def test_a_missing_package_is_an_import_error_at_its_first_use() -> None:
    absent = later.Later("no_such_package")
    with pytest.raises(ImportError, match="no_such_package"):
        _ = absent.anything


def test_a_name_that_the_package_lacks_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = later.Later("json").no_such_name


def test_what_is_needed_is_imported_or_its_command_is_named() -> None:
    assert later.need("Archives need", "zip", "json", "zipfile").is_zipfile(__file__) is False
    with pytest.raises(MissingPackageError) as caught:
        later.need("Archives need", "No-Such", "zipfile", "no_such_package", instead="unpack it yourself")
    assert str(caught.value) == "Archives need No-Such. Install it with: pip install No-Such, or unpack it yourself."
    assert caught.value.context == {"package": "No-Such"}


WAITING = """
import sys
import threading
from kilter_files.ground.later import later

with later(__name__):
    import xml.dom.minidom as dom
    from json import tool
    other = threading.Thread(target=exec, args=("import wave", {"__name__": "other"}))
    other.start()
    other.join()
loaded = [name in sys.modules for name in ("xml.dom.minidom", "json.tool", "wave")]
import colorsys
print(*loaded, "colorsys" in sys.modules, dom.parseString("<a/>").documentElement.tagName, callable(tool.main))
"""


def test_only_what_the_module_itself_imports_in_its_block_waits() -> None:
    done = subprocess.run([sys.executable, "-c", WAITING], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False", "True", "True", "a", "True"]
