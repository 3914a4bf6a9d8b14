"""``diag-service config check``: what a run would use, checked, secrets masked."""

import logging
import sys
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import tomli_w

from clutchdiag_io.files import legible
from diag_service.service.stopping import Controls
from diag_service.settings.config import bus_config, diagnosis_config
from diag_service.settings.options import SETTINGS

_LOG = logging.getLogger(__name__)


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Check the settings and print them."""
    del controls
    diagnosis = diagnosis_config(options)
    bus_config(options)
    diagnosis.interpretation()
    broker = diagnosis.broker
    if broker is not None and broker.exposure:
        _LOG.warning("%s", broker.exposure)
    sys.stdout.write(describe(options))


def describe(options: SimpleNamespace) -> str:
    """Return the options as the text of a settings file, with what is secret masked."""
    return "".join(_line(name, getattr(options, name)) for name in SETTINGS)


def _line(name: str, value: str | float | Path | None) -> str:
    if value is None:
        return f"# {name} is not set\n"
    if isinstance(value, str | Path):
        value = legible(_masked(str(value)) if name == "broker" else str(value))
    return tomli_w.dumps({name: value})


def _masked(url: str) -> str:
    """Return a URL without its password."""
    password = urlsplit(url).password
    return url if password is None else url.replace(f":{password}@", ":***@")
