"""The key of a kernel's machine code changes with what is compiled into it, and with nothing else."""

import sys
from collections.abc import Iterator
from importlib import import_module
from itertools import count
from pathlib import Path
from types import ModuleType

import pytest

from canlog.jit import kernel_key

LAW = '''"""A law and its constants."""
import numpy as np
from typing import NamedTuple
from canlog.jit import array_kernel, inlined_kernel, kernel
from {package} import numbers

FACTOR = 2.0
TABLE = np.array([1.0, 2.0])

class Pair(NamedTuple):
    first: float
    second: float

@kernel
def inner(value: float) -> float:
    """Return half of it."""
    return 0.5 * value

@kernel
def outer(pair: Pair) -> float:
    return inner(pair.first) * FACTOR + TABLE[0] + numbers.OFFSET + LATE + numbers.helper(1.0)

@kernel
def stranger(value: float) -> float:
    return value

LATE = 4.0
'''
NUMBERS = '''"""Constants, and a kernel that others reach by the module."""
from canlog.jit import kernel
OFFSET = 3.0
UNUSED = 7.0

@kernel
def helper(value: float) -> float:
    return value + 1.0
'''
_numbers = count()


PACKAGE = "laws_of_a_workshop"


@pytest.fixture
def workshop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator["Workshop"]:
    yield Workshop(tmp_path, monkeypatch)
    forget()


def forget() -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == PACKAGE]:
        del sys.modules[name]


class Workshop:
    """Imports the sources above anew, edited or not, always under the same name."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._folder = folder
        self._monkeypatch = monkeypatch

    def key(self, old: str = "", new: str = "", name: str = "outer") -> str:
        return kernel_key(getattr(self.law(old, new), name).py_func)

    def law(self, old: str = "", new: str = "", module: str = "law") -> ModuleType:
        assert old in LAW + NUMBERS
        forget()
        folder = self._folder / str(next(_numbers)) / PACKAGE
        self._monkeypatch.syspath_prepend(str(folder.parent))
        folder.mkdir(parents=True)
        (folder / "__init__.py").touch()
        (folder / "numbers.py").write_text(NUMBERS.replace(old, new) if old else NUMBERS)
        text = LAW.replace(old, new) if old else LAW
        (folder / f"{module}.py").write_text(text.replace("{package}", PACKAGE))
        return import_module(f"{PACKAGE}.{module}")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("FACTOR = 2.0", "FACTOR = 2.5"),
        ("FACTOR = 2.0", "FACTOR = 2"),
        ("0.5 * value", "0.25 * value"),
        ("[1.0, 2.0]", "[1.0, 2.5]"),
        ("OFFSET = 3.0", "OFFSET = 3.5"),
        ("LATE = 4.0", "LATE = 4.5"),
        ("value + 1.0", "value + 2.0"),
        ("    first: float\n    second: float", "    second: float\n    first: float"),
        ("@kernel\ndef inner", "@inlined_kernel\ndef inner"),
        ("@kernel\ndef outer", "@array_kernel\ndef outer"),
    ],
)
def test_what_is_compiled_in_changes_the_key(workshop: Workshop, old: str, new: str) -> None:
    assert workshop.key(old, new) != workshop.key()
