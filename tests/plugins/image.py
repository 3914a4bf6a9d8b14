"""Pytest plugin: the project's wheel in an environment of its own, outside the checkout, as the Dockerfile makes it."""

import pytest

from tests.support.documents import ROOT
from tests.support.image.plain import PlainImage


@pytest.fixture(scope="session")
def image(tmp_path_factory: pytest.TempPathFactory) -> PlainImage:
    """Return the image in a plain folder; who needs it stands beside test_image.py, so that one process makes it."""
    import numba.core.config  # noqa: PLC0415 - half a second, for few tests

    from canlog.jit import cache_folder  # noqa: PLC0415 - likewise

    kernels = cache_folder(numba.core.config.CACHE_DIR)  # type: ignore[attr-defined]  # set at run time
    assert kernels is not None
    return PlainImage(ROOT, tmp_path_factory.mktemp("image") / "root", kernels.parent)
