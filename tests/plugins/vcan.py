"""Pytest plugin: a vcan interface of its own for each test, so that a test may switch it off."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

import pytest

from tests.uml.vcan import create_vcan, ip_link

_numbers = count(10)


@contextmanager
def own_vcan() -> Iterator[str]:
    """Make a vcan interface that is up and that nobody else uses, and yield its name; needs the rights to make one."""
    name = f"vcan{next(_numbers)}"
    if not create_vcan(name):
        raise RuntimeError(f"cannot create {name}: run `python -m tests.uml.run -- COMMAND`, as root if vcan is native")
    yield name
    ip_link("delete", name)


@pytest.fixture
def vcan() -> Iterator[str]:
    """Return the name of a vcan interface that belongs to one test."""
    with own_vcan() as name:
        yield name
