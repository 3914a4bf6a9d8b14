"""Options that several commands share, as checked values."""

from dataclasses import replace
from types import SimpleNamespace

from diag_service.delivery import Acknowledge
from diag_service.errors import ConfigError
from diag_service.settings import config
from fleet_link import TlsFiles


def diagnosis_config(options: SimpleNamespace) -> config.DiagnosisConfig:
    """Return how frames become results; names the vehicle. Raises ConfigError or CalibrationError."""
    calibration = config.load_calibration(options.calibration)
    options.vehicle = config.vehicle_of(options.vehicle, calibration)
    settings = config.DiagnosisConfig(
        vehicle=options.vehicle,
        dbc=options.dbc,
        is_lenient=options.lenient,
        profile=options.profile,
        calibration=calibration,
        is_strict=getattr(options, "strict", False),
    )
    return _with_delivery(settings, options) if hasattr(options, "broker") else settings


def bus_config(options: SimpleNamespace) -> config.BusConfig:
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


def _with_delivery(settings: config.DiagnosisConfig, options: SimpleNamespace) -> config.DiagnosisConfig:
    """Return the settings with those that only commands have which deliver and store results."""
    tls = config.tls_files(options.ca, options.cert, options.key)
    broker = config.parse_broker(options.broker, tls, options.password_file) if options.broker else None
    if broker is None and (tls != TlsFiles() or options.password_file is not None):
        raise ConfigError("certificates and passwords need a broker")
    return replace(
        settings,
        broker=broker,
        acknowledge=Acknowledge(options.acknowledge),
        budget_bytes=None if options.store_budget is None else options.store_budget << 20,
    )
