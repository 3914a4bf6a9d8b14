"""``diag-service config check``: what a run would use, checked, secrets masked."""

import logging
import sys
from types import SimpleNamespace

from diag_service.commands.meaning import bus_config, diagnosis_config
from diag_service.mapping.interpretation import interpret
from diag_service.service.stopping import Trigger
from diag_service.settings.options import describe

_LOG = logging.getLogger(__name__)


def execute(options: SimpleNamespace, stop: Trigger, counts_wanted: Trigger) -> None:
    """Check the settings and print them."""
    del stop, counts_wanted
    diagnosis = diagnosis_config(options)
    bus_config(options)
    interpret(diagnosis.dbc, diagnosis.profile, is_lenient=diagnosis.is_lenient)
    broker = diagnosis.broker
    if broker is not None and broker.exposure:
        _LOG.warning("%s", broker.exposure)
    sys.stdout.write(describe(options))
