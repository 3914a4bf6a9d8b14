"""Options that several commands share, as checked values."""

import argparse

from diag_service.delivery import Acknowledge, BrokerAddress, TlsFiles
from diag_service.errors import ConfigError
from diag_service.settings import config
from diag_service.settings.options import fill_in


def diagnosis_config(options: argparse.Namespace) -> config.DiagnosisConfig:
    """Return how frames become results, open options filled in; raises ConfigError or CalibrationError."""
    fill_in(options)
    calibration = config.load_calibration(options.calibration)
    options.vehicle = config.vehicle_of(options.vehicle, calibration)
    return config.DiagnosisConfig(
        vehicle=options.vehicle,
        dbc=options.dbc,
        is_lenient=options.lenient,
        profile=options.profile,
        calibration=calibration,
        broker=_broker(options),
        acknowledge=Acknowledge(options.acknowledge),
        budget_bytes=None if options.store_budget is None else options.store_budget << 20,
        is_strict=options.command == "analyze" and options.strict,
    )


def bus_config(options: argparse.Namespace) -> config.BusConfig:
    """Return which bus to listen to; raises ConfigError."""
    return config.BusConfig(
        interface=options.interface,
        channel=options.channel,
        bitrate=options.bitrate,
        is_fd=options.fd,
        duration_s=options.duration,
        is_filtered=options.only_mapped,
        metrics=config.parse_listen_address(options.metrics) if options.metrics else None,
    )


def _broker(options: argparse.Namespace) -> BrokerAddress | None:
    tls = TlsFiles(authority=options.ca, certificate=options.cert, key=options.key)
    if options.broker:
        return config.parse_broker(options.broker, tls, options.password_file)
    if options.command not in {"calibrate", "monitor"} and (tls != TlsFiles() or options.password_file is not None):
        raise ConfigError("certificates and passwords need a broker")
    return None
