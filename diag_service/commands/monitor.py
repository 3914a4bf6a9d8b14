"""``diag-service monitor``: show a live bus, store nothing."""

from types import SimpleNamespace

from diag_service.service import bus_run
from diag_service.service.stopping import Controls
from diag_service.settings.config import bus_config, diagnosis_config


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Show the bus until it is told to stop."""
    bus_run.run_monitor(diagnosis_config(options), bus_config(options), controls)
