"""``diag-service run``: diagnose a live bus."""

from types import SimpleNamespace

from diag_service.service import bus_run
from diag_service.service.stopping import Controls
from diag_service.settings.config import bus_config, default_store, diagnosis_config


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Diagnose the bus until it is told to stop."""
    diagnosis = diagnosis_config(options)
    bus = bus_config(options)
    store = options.store or default_store(diagnosis.vehicle)
    bus_run.run_bus(diagnosis, bus, store, controls, as_json=options.json, is_detailed=options.verbose > 0)
