"""Pytest plugin: the project's wheels in an environment of their own, made as the Dockerfile makes the image."""

import fcntl
import os
from pathlib import Path

import pytest

from tests.support.documents import ROOT
from tests.support.image.plain import PlainImage


@pytest.fixture(scope="session")
def image(shared_folder: Path) -> PlainImage:
    """Return the image in a plain folder, made once per run, for all of its workers."""
    kernels = Path(os.environ["NUMBA_CACHE_DIR"])
    with (shared_folder / "image.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return PlainImage(ROOT, shared_folder / "image", kernels)
