"""``diag-service monitor``: show a live bus, store nothing."""

from types import SimpleNamespace

from diag_service.commands.meaning import bus_config, diagnosis_config
from diag_service.service import application
from diag_service.service.stopping import Trigger


def execute(options: SimpleNamespace, stop: Trigger, counts_wanted: Trigger) -> None:
    """Show the bus until it is told to stop."""
    controls = application.Controls(stop=stop, counts_wanted=counts_wanted)
    application.run_monitor(diagnosis_config(options), bus_config(options), controls)
