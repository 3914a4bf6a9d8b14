"""Pytest plugin: small file systems, for disks that are full or sealed; for tests that may mount."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

Mount = Callable[[str], Path]


@pytest.fixture
def mount(tmp_path: Path) -> Iterator[Mount]:
    """Return a function that mounts a tmpfs with the options it is given and returns where."""
    with ExitStack() as mounted:

        def mount_tmpfs(options: str) -> Path:
            folder = tmp_path / f"disk{len(list(tmp_path.glob('disk*')))}"
            folder.mkdir()
            subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)
            mounted.callback(subprocess.run, ["umount", "-l", str(folder)], check=True)
            return folder

        yield mount_tmpfs
