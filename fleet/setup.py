"""What the fleet needs besides pyproject.toml: the core, which is on no index and so comes from this checkout.

A build for others names it by its version: ``CLUTCHDIAG_RELEASE=1`` (``make wheels``).
"""

import os
from pathlib import Path

from setuptools import setup

CORE = Path(__file__).parents[1].resolve()
setup(
    install_requires=[
        "aiomqtt>=2.5,<3",
        "alembic>=1.14",
        "click>=8.5",
        "jinja2>=3.1",
        "markupsafe>=2.1",
        "msgspec>=0.22",
        "numpy>=2.0",
        "prometheus-client>=0.22",
        "psycopg[binary]>=3.2",
        "rich>=14",
        "sqlalchemy>=2.0",
        "clutchdiag>=0.9" if os.environ.get("CLUTCHDIAG_RELEASE") else f"clutchdiag @ {CORE.as_uri()}",
    ]
)
