"""``diag-service analyze --lake``: logs in folders or stores into a lake, by processes here or by a cluster."""

import logging
import os
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Final

from canlog.logs import STANDARD_INPUT
from canlog.notice import NOTICE
from diag_service.commands.cluster import tls_files
from diag_service.errors import ConfigError
from diag_service.lake.links import ClusterAddress
from diag_service.lake.places import Place
from diag_service.lake.run import LakeTotals, fill_lake, find_logs
from diag_service.lake.work import Job
from diag_service.service.stopping import Controls
from diag_service.settings.config import check_vehicle, diagnosis_config

LOCAL: Final = "local"
_NOT_FOR_LAKES: Final = ("output", "store", "broker", "json", "force")
_LOG = logging.getLogger(__name__)


def fill(options: SimpleNamespace, controls: Controls) -> None:
    """Bring a lake up to date; raises ConfigError if the words contradict each other, and what ``fill_lake`` raises."""
    _check(options)
    scheduler = None if options.scheduler == LOCAL else ClusterAddress.parse(options.scheduler, tls_files(options))
    options.ca = options.cert = options.key = options.broker = None  # the scheduler's, and nothing is published
    config = replace(diagnosis_config(options), budget_bytes=None)
    lake = Place(str(options.lake))
    has_vehicles = options.vehicle_from is not None
    logs = find_logs([str(log) for log in options.logs], lake, config.vehicle, has_vehicles=has_vehicles)
    for vehicle in {log.vehicle for log in logs}:
        replace(config, vehicle=check_vehicle(vehicle))  # complains of a calibration of another one
    totals = fill_lake(
        Job.of(config, lake.address, options.signals, options.time_limit),
        logs,
        scheduler,
        jobs=options.jobs or os.cpu_count() or 1,
        stream=sys.stdout,
        stop=controls.stop,
        is_shown=True,
        is_retried=options.retry,
    )
    _tell(totals, lake)


def _check(options: SimpleNamespace) -> None:
    if given := [name for name in _NOT_FOR_LAKES if name in options.given]:
        raise ConfigError(f"--{given[0]} does not go with --lake: the results are in the lake")
    if options.estimator == "paper":
        raise ConfigError("the paper's method states no uncertainty: its results are shown, not kept")
    if STANDARD_INPUT in options.logs:
        raise ConfigError("a lake is made of what lies in folders and stores: standard input does not go with it")
    if options.vehicle_from is not None and "vehicle" in options.given:
        raise ConfigError(
            "--vehicle-from takes the vehicles from the folders, --vehicle names one: use only one of them"
        )
    if options.jobs is not None and options.jobs < 1:
        raise ConfigError(f"--jobs must be at least 1, got {options.jobs}")
    if options.scheduler == LOCAL and (options.ca or options.cert or options.key):
        raise ConfigError("--ca, --cert and --key are for a scheduler: --scheduler tls://HOST:PORT")


def _tell(totals: LakeTotals, lake: Place) -> None:
    sys.stdout.write(
        f"{totals.found} logs: {totals.before} in the lake before, {totals.done} analysed with {totals.shifts} shifts, "
        f"{totals.failed} not\n"
    )
    _LOG.log(NOTICE, "the lake is %s", lake.address)
