"""Options that several commands share, as checked values."""

import argparse

from diag_service import config


def diagnosis_config(options: argparse.Namespace) -> config.DiagnosisConfig:
    """Return how frames become results; raises ConfigError or CalibrationError."""
    return config.DiagnosisConfig(
        vehicle=config.check_vehicle(options.vehicle),
        dbc=options.dbc,
        profile=options.profile,
        calibration=config.load_calibration(options.calibration),
        broker=config.parse_broker(options.broker) if options.broker else None,
    )


def bus_config(options: argparse.Namespace) -> config.BusConfig:
    """Return which bus to listen to; raises ConfigError."""
    return config.BusConfig(
        interface=options.interface,
        channel=options.channel,
        bitrate=options.bitrate,
        is_fd=options.fd,
        duration_s=options.duration,
        metrics=config.parse_listen_address(options.metrics) if options.metrics else None,
    )
