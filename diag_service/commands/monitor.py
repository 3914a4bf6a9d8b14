"""``diag-service monitor``: show a live bus, store nothing."""

from types import SimpleNamespace

from diag_service.console.terminal import PeopleConsole
from diag_service.mapping.databases import asked_database
from diag_service.service import bus_run
from diag_service.service.stopping import Controls
from diag_service.settings.config import bus_config, diagnosis_config


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Show the bus, or what is said on it, until it is told to stop."""
    if options.conversations or options.pairs:
        # Imported here: the monitor needs none of it.
        from diag_service.commands.conversations import Conversations  # noqa: PLC0415 - see above
        from diag_service.commands.conversations_live import follow_bus  # noqa: PLC0415 - see above

        messages = asked_database(options).messages
        follow_bus(
            bus_config(options), Conversations(messages, options.pairs or ""), controls.stop, PeopleConsole().print
        )
        return
    bus_run.run_monitor(diagnosis_config(options), bus_config(options), controls)
