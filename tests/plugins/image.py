"""Pytest plugin: the project's wheel in an environment of its own, outside the checkout, as the Dockerfile makes it."""

import os
from pathlib import Path

import pytest

from tests.support.documents import ROOT
from tests.support.image.plain import PlainImage


@pytest.fixture(scope="session")
def image(tmp_path_factory: pytest.TempPathFactory) -> PlainImage:
    """Return the image in a plain folder; who needs it stands beside test_image.py, so that one process makes it."""
    kernels = Path(os.environ["NUMBA_CACHE_DIR"]).parent
    return PlainImage(ROOT, tmp_path_factory.mktemp("image") / "root", kernels)
