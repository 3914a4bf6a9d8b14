"""``diag-service run``, ``monitor`` and ``config check``: a live bus is diagnosed or shown, or what a run would use."""

import logging
import sys
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import tomli_w

from clutchdiag_io.program import legible
from diag_service.api.choices import diagnosis_config
from diag_service.service import bus_run
from diag_service.service.stopping import Controls
from diag_service.settings.config import bus_config, default_store
from diag_service.settings.options import SETTINGS


def run(options: SimpleNamespace, controls: Controls) -> None:
    """Diagnose the bus until it is told to stop."""
    diagnosis = diagnosis_config(options)
    bus = bus_config(options)
    store = options.store or default_store(diagnosis.vehicle)
    bus_run.run_bus(diagnosis, bus, store, controls, as_json=options.json, is_detailed=options.verbose > 0)


def monitor(options: SimpleNamespace, controls: Controls) -> None:
    """Show the bus until it is told to stop."""
    bus_run.run_monitor(diagnosis_config(options), bus_config(options), controls)


_LOG = logging.getLogger(__name__)


def config(options: SimpleNamespace, controls: Controls) -> None:
    del controls
    diagnosis = diagnosis_config(options)
    bus_config(options)
    diagnosis.interpretation()
    broker = diagnosis.broker
    if broker is not None and broker.exposure:
        _LOG.warning("%s", broker.exposure)
    sys.stdout.write(describe({**vars(options), "vehicle": diagnosis.vehicle}))


def describe(values: Mapping[str, Any]) -> str:
    """Return values of settings as the text of a settings file, with what is secret masked."""
    return "".join(_line(name, values[name]) for name in SETTINGS)


def _line(name: str, value: str | float | Path | None) -> str:
    if value is None:
        return f"# {name} is not set\n"
    if isinstance(value, str | Path):
        text = str(value)
        if name == "broker" and (password := urlsplit(text).password) is not None:
            text = text.replace(f":{password}@", ":***@")
        value = legible(text)
    return tomli_w.dumps({name: value})
