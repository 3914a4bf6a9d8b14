"""``diag-service run``: diagnose a live bus."""

from contextlib import AbstractContextManager
from types import SimpleNamespace

from diag_service.service import bus_run
from diag_service.service.onlookers import LiveRun
from diag_service.service.stopping import Controls
from diag_service.settings.config import ListenAddress, bus_config, default_store, diagnosis_config


def _open_page(address: ListenAddress, run: LiveRun) -> AbstractContextManager[str]:
    from diag_service.live_page import opened_page  # noqa: PLC0415 - templates and pictures, for few runs

    return opened_page(address, run)


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Diagnose the bus until it is told to stop."""
    diagnosis = diagnosis_config(options)
    bus = bus_config(options)
    store = options.store or default_store(diagnosis.vehicle)
    bus_run.run_bus(
        diagnosis, bus, store, controls, as_json=options.json, is_detailed=options.verbose > 0, open_page=_open_page
    )
