"""Pytest plugin: small file systems, for disks that are full or sealed; for tests that may mount."""

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Protocol

import pytest

_PIECE_BYTES = 4096


class Mount(Protocol):
    """Mounts a tmpfs with the options it is given and returns where; by default below the test's own folder."""

    def __call__(self, options: str, parent: Path | None = None) -> Path: ...


def fill_up(disk: Path) -> Path:
    """Fill a file system to its last page; return the file that did."""
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as out, suppress(OSError):
        while True:
            out.write(bytes(_PIECE_BYTES))
    return filler


@pytest.fixture
def mount(tmp_path: Path) -> Iterator[Mount]:
    """Return a function that mounts a tmpfs, which does not outlive the test."""
    with ExitStack() as mounted:

        def mount_tmpfs(options: str, parent: Path | None = None) -> Path:
            parent = parent or tmp_path
            folder = parent / f"disk{len(list(parent.glob('disk*')))}"
            folder.mkdir()
            subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)
            mounted.callback(subprocess.run, ["umount", "-l", str(folder)], check=True)
            return folder

        yield mount_tmpfs
