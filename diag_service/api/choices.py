"""What a caller may choose, as Python values: checked in the same place as the options of the command line."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

from clutch_model.calibration import Calibration
from diag_service.delivery import Acknowledge
from diag_service.errors import ConfigError
from diag_service.settings.config import (
    DeliveryOptions,
    DiagnosisConfig,
    MeaningOptions,
    PollConfig,
    as_profiled,
    broker_of,
    described_by,
    vehicle_of,
)

if TYPE_CHECKING:
    import can

AnyPath = str | os.PathLike[str]
AnyPaths = AnyPath | Iterable[AnyPath]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Poll:
    """That a controller is asked for its trouble codes while its bus is diagnosed; each member is an option of ``run``.

    To make one is the leave to send requests, as ``--active`` is.

    Attributes
    ----------
    period_s : float
        From one answer to the next question, 1 s or more.
    ecu, reply : int, optional
        Identifier of requests, and of answers; by default as described, or 7E1 and what the standard has for it.
    description : path, optional
        What the controller has: TOML, PDX, or the name of a shipped one; by default what it says it is.
    bus : can.BusABC, optional
        An open end of the bus for the questions alone. A bus that is diagnosed by its name is opened once more instead.
    """

    period_s: float = 60.0
    ecu: int | None = None
    reply: int | None = None
    description: AnyPath | None = None
    bus: "can.BusABC | None" = None


class FrameMeaning(TypedDict, total=False):
    """What frames mean and whose they are, as functions take it by keyword; ``analyze`` says what each stands for."""

    vehicle: str | None
    dbc: AnyPath | None
    profile: AnyPath | None
    calibration: Calibration | AnyPath | None


class LogMeaning(FrameMeaning, total=False):
    """The same of logs, which may be tables."""

    columns: str


def configuration(
    *,
    is_strict: bool = False,
    delivery: Delivery | None = None,
    store_budget_mib: int | None = None,
    vehicle: str | None = None,
    dbc: AnyPath | None = None,
    profile: AnyPath | None = None,
    calibration: Calibration | AnyPath | None = None,
    columns: str = "",
) -> DiagnosisConfig:
    """Return how frames become results; raises ConfigError or CalibrationError, and TypeError for another keyword."""
    named = calibration if isinstance(calibration, Calibration) else optional_path(calibration)
    chosen, gears = described_by(named, optional_path(profile))
    broker = None
    if delivery is not None:
        files = (delivery.ca, delivery.cert, delivery.key, delivery.password_file)
        broker = broker_of(delivery.broker, *map(optional_path, files))
    return DiagnosisConfig(
        vehicle=vehicle_of(vehicle, chosen),
        calibration=as_profiled(chosen, optional_path(profile)),
        gears=gears,
        vehicle_file=None if isinstance(named, Calibration) else named,
        dbc=optional_path(dbc),
        profile=optional_path(profile),
        is_strict=is_strict,
        columns=columns,
        broker=broker,
        acknowledge=Acknowledge.BROKER if delivery is None else _acknowledge(delivery.acknowledge),
        budget_bytes=None if store_budget_mib is None else store_budget_mib << 20,
    )


def diagnosis_config(options: MeaningOptions) -> DiagnosisConfig:
    """Return what the words of a command line stand for; raises as ``configuration``."""
    if options.vehicle_file is not None and options.calibration is not None:
        raise ConfigError("a vehicle file holds a calibration: give either --vehicle-file or --calibration")
    delivery, budget_mib = None, None
    if isinstance(options, DeliveryOptions):
        budget_mib = options.store_budget
        delivery = Delivery(
            broker=options.broker or "",
            ca=options.ca,
            cert=options.cert,
            key=options.key,
            password_file=options.password_file,
            acknowledge=options.acknowledge,
        )
    return configuration(
        vehicle=options.vehicle,
        dbc=options.dbc,
        profile=options.profile,
        calibration=options.vehicle_file or options.calibration,
        is_strict=options.strict,
        columns=options.columns,
        delivery=delivery,
        store_budget_mib=budget_mib,
    )


def path_list(paths: AnyPaths) -> list[Path]:
    """Return one path or several as a list; raises ConfigError if there is none."""
    named = [Path(paths)] if isinstance(paths, str | os.PathLike) else [Path(path) for path in paths]
    if not named:
        raise ConfigError("no log is named")
    return named


def optional_path(path: AnyPath | None) -> Path | None:
    return None if path is None else Path(path)


def poll_config(poll: Poll | None) -> PollConfig | None:
    """Return how a controller is asked; raises ConfigError."""
    if poll is None:
        return None
    return PollConfig(
        period_s=poll.period_s,
        ecu=None if poll.ecu is None else f"{poll.ecu:X}",
        reply=None if poll.reply is None else f"{poll.reply:X}",
        description=optional_path(poll.description),
        bus=poll.bus,
    )


def check_one_bus(bus: "can.BusABC | None", *names: object) -> None:
    """Raise ConfigError if a bus was handed over open and named besides."""
    if bus is not None and any(name is not None and name is not False for name in names):
        raise ConfigError("give either an open bus or an interface and a channel, not both")


def _acknowledge(word: str) -> Acknowledge:
    try:
        return Acknowledge(word)
    except ValueError as exc:
        raise ConfigError(f"acknowledge must be {' or '.join(Acknowledge)}, got {word!r}") from exc
