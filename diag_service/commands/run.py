"""``diag-service run``: diagnose a live bus."""

from types import SimpleNamespace

from diag_service.commands.meaning import bus_config, diagnosis_config
from diag_service.service import application
from diag_service.service.stopping import Trigger
from diag_service.settings import config


def execute(options: SimpleNamespace, stop: Trigger, counts_wanted: Trigger) -> None:
    """Diagnose the bus until it is told to stop."""
    diagnosis = diagnosis_config(options)
    bus = bus_config(options)
    store = options.store or config.default_store(diagnosis.vehicle)
    controls = application.Controls(stop=stop, counts_wanted=counts_wanted)
    application.run_bus(diagnosis, bus, store, controls, as_json=options.json)
