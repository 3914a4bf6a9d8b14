"""What a caller may choose, as Python values: checked in the same place as the options of the command line."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

from clutch_model.calibration import Calibration, nominal_calibration, read_calibration
from diag_service.delivery import Acknowledge
from diag_service.errors import ConfigError
from diag_service.settings.config import DiagnosisConfig, broker_of, vehicle_of

AnyPath = str | os.PathLike[str]
AnyPaths = AnyPath | Iterable[AnyPath]
BYTES_PER_MIB = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Delivery:
    """Where results are sent; each member is the option of that name.

    Attributes
    ----------
    broker : str
        ``mqtt[s]://[user[:password]@]host[:port]``.
    ca, cert, key, password_file : path, optional
        Files for an encrypted connection, and with the password; key and password are readable for their owner only.
    acknowledge : "broker" or "backend"
        Whose word lets a result be forgotten.
    """

    broker: str
    ca: AnyPath | None = None
    cert: AnyPath | None = None
    key: AnyPath | None = None
    password_file: AnyPath | None = None
    acknowledge: Literal["broker", "backend"] = "broker"


def configuration(
    *,
    vehicle: str | None = None,
    dbc: AnyPath | None = None,
    profile: AnyPath | None = None,
    calibration: Calibration | AnyPath | None = None,
    is_lenient: bool = False,
    is_strict: bool = False,
    delivery: Delivery | None = None,
    store_budget_mib: int | None = None,
) -> DiagnosisConfig:
    """Return how frames become results; raises ConfigError or CalibrationError."""
    chosen = _calibration(calibration)
    return DiagnosisConfig(
        vehicle=vehicle_of(vehicle, chosen),
        calibration=chosen,
        dbc=optional_path(dbc),
        profile=optional_path(profile),
        is_lenient=is_lenient,
        is_strict=is_strict,
        broker=None if delivery is None else broker_of(_options(delivery)),
        acknowledge=Acknowledge.BROKER if delivery is None else _acknowledge(delivery.acknowledge),
        budget_bytes=None if store_budget_mib is None else store_budget_mib * BYTES_PER_MIB,
    )


def path_list(paths: AnyPaths) -> list[Path]:
    """Return one path or several as a list; raises ConfigError if there is none."""
    named = [Path(paths)] if isinstance(paths, str | os.PathLike) else [Path(path) for path in paths]
    if not named:
        raise ConfigError("no log is named")
    return named


def optional_path(path: AnyPath | None) -> Path | None:
    """Return a path that may be missing."""
    return None if path is None else Path(path)


def _calibration(choice: Calibration | AnyPath | None) -> Calibration:
    if isinstance(choice, Calibration):
        return choice
    return nominal_calibration() if choice is None else read_calibration(Path(choice))


def _options(delivery: Delivery) -> SimpleNamespace:
    files = {name: optional_path(getattr(delivery, name)) for name in ("ca", "cert", "key", "password_file")}
    return SimpleNamespace(broker=delivery.broker, **files)


def _acknowledge(word: str) -> Acknowledge:
    try:
        return Acknowledge(word)
    except ValueError as exc:
        raise ConfigError(f"acknowledge must be {' or '.join(Acknowledge)}, got {word!r}") from exc
