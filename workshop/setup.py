"""What the workshop needs besides pyproject.toml: the core, which is on no index and so comes from this checkout.

A build for others names it by its version: ``CLUTCHDIAG_RELEASE=1`` (``make wheels``).
"""

import os
from pathlib import Path

from setuptools import setup

CORE = Path(__file__).parents[1].resolve()
setup(
    install_requires=[
        "cantools>=41",
        "click>=8.5",
        "msgspec>=0.22",
        "numpy>=2.0",
        "python-can>=4.6",
        "clutchdiag>=0.9" if os.environ.get("CLUTCHDIAG_RELEASE") else f"clutchdiag @ {CORE.as_uri()}",
    ]
)
