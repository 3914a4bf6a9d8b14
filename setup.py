"""What the core needs besides pyproject.toml: canlog, which is on no index and so comes from this checkout.

A build for others names it by its version: ``CLUTCHDIAG_RELEASE=1`` (``make wheels``).
"""

import os
from pathlib import Path

from setuptools import setup

CANLOG = Path(__file__).parent.resolve() / "canlog"
REQUIREMENTS = [
    "aiomqtt>=2.5,<3",
    "cantools>=41",
    "click>=8.5",
    "filterpy>=2.0",
    "jinja2>=3.1",
    "jsonschema-rs>=0.60",
    "markupsafe>=2.1",
    "msgspec>=0.22",
    "numba>=0.61",
    "numpy>=2.0",
    "paho-mqtt>=2.1,<3",
    "prometheus-client>=0.22",
    "python-can>=4.6",
    "rich>=14",
    "scipy>=1.14",
    "tomli-w>=1.2",
]
setup(
    install_requires=[
        *REQUIREMENTS,
        "canlog>=0.9" if os.environ.get("CLUTCHDIAG_RELEASE") else f"canlog @ {CANLOG.as_uri()}",
    ]
)
