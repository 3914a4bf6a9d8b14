"""``diag-service config check``: what a run would use, checked, secrets masked."""

import argparse
import sys

from diag_service.commands.meaning import bus_config, diagnosis_config
from diag_service.options import describe
from diag_service.stopping import Trigger


def execute(options: argparse.Namespace, stop: Trigger, counts_wanted: Trigger) -> None:
    """Check the settings and print them."""
    del stop, counts_wanted
    diagnosis_config(options)
    bus_config(options)
    sys.stdout.write(describe(options))
