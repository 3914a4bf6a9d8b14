"""The options of each command as one record, for command lines and for Python, and what they stand for.

Tables of signals without database and profile are read with the profile that is proposed for them.
"""

import logging
import tomllib
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from cantools.database.can import Message

from canlog.errors import NOTICE
from canlog.files import is_folder
from canlog.logs import STANDARD_INPUT, table_columns
from canlog.logs.streams import never
from clutch_model.calibration import Calibration, nominal_calibration
from clutchdiag_io.program import legible, replacement_refusal
from diag_service.delivery import Acknowledge
from diag_service.errors import ConfigError
from diag_service.mapping.interpretation import open_database
from diag_service.mapping.learning import proposed_profile
from diag_service.mapping.mapped_messages import reach_in_words
from diag_service.mapping.profile import Profile, profile_of
from diag_service.settings.config import (
    PROPOSED,
    BusConfig,
    DiagnosisConfig,
    PollConfig,
    as_profiled,
    described_by,
    parse_listen_address,
    vehicle_of,
)
from fleet_link import AddressError, BrokerAddress, TlsFiles, parse_broker

_LOG = logging.getLogger(__name__)


def check_replaceable(path: Path, *, is_forced: bool) -> None:
    """Raise ConfigError if a new file must not take the place of what is there."""
    if text := replacement_refusal(path, is_forced=is_forced):
        raise ConfigError(text)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeaningOptions:
    """What frames mean and whose they are."""

    vehicle: str | None = None
    dbc: Path | None = None
    profile: Path | None = None
    calibration: Calibration | Path | None = None
    vehicle_file: Path | None = None
    columns: str = ""
    strict: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class DeliveryOptions(MeaningOptions):
    """The same, and where results are kept and sent."""

    store: Path | None = None
    store_budget: int | None = None  # [MiB]
    broker: str | None = None
    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None
    password_file: Path | None = None
    acknowledge: Literal["broker", "backend"] = "broker"


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveOptions(DeliveryOptions):
    """The same of a bus: which one is listened to, and what is asked on it."""

    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    fd: bool = False
    only_mapped: bool = False
    duration: float | None = None  # [s]
    once: bool = False
    metrics: str | None = None
    poll: float | None = None  # [s]
    adapter: str | None = None
    active: bool = False
    ecu: str | None = None
    reply: str | None = None
    description: Path | None = None
    json: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AnalyzeOptions(DeliveryOptions):
    """What is analysed, and how."""

    logs: tuple[Path | str, ...]  # a text is the address of a store
    estimator: str = "impulse"
    output: Path | None = None
    force: bool = False
    jobs: int | None = None
    vehicle_from: str | None = None
    lake: Path | str | None = None
    scheduler: str = "local"
    signals: str | None = None
    time_limit: float = 0.0  # of each log of a lake [s]
    retry: bool = False
    json: bool = False
    given: frozenset[str] = frozenset()  # what the command line itself says, not a settings file

    @property
    def paths(self) -> list[Path]:
        """The logs that are files or folders of this machine."""
        return [log for log in self.logs if isinstance(log, Path)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions(MeaningOptions):
    """What a report is of, and where it goes."""

    logs: tuple[Path, ...]  # or a store
    output: Path
    full: bool = False
    force: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnOptions(MeaningOptions):
    """From which logs a file about their vehicle is made."""

    logs: tuple[Path, ...]
    output: Path | None = None  # None: nowhere
    force: bool = False
    json: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictOptions(MeaningOptions):
    """Which shifts are predicted, and from what."""

    logs: tuple[Path, ...]
    touch_pa: float | None = None  # touch point of the clutches; None: the pressure in gear at standstill
    halves: bool = False
    each_log: bool = False
    json: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryOptions:
    """Whose history is shown, and how."""

    store: Path
    vehicle: str | None = None
    clutch: int | None = None
    rows: int = 20
    calibration: Path | None = None
    peers: Path | None = None
    json: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class FluidOptions:
    """Which fill of fluid is noted, or withdrawn."""

    store: Path
    vehicle: str | None = None
    at: str | None = None
    odometer: float | None = None  # [km]
    product: str | None = None
    note: str | None = None
    insist: bool = False
    undo: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class InspectOptions:
    """Which logs are inspected, and how."""

    logs: tuple[Path, ...]
    dbc: Path | None = None
    match: str = "database"
    columns: str = ""
    bitrate: int  # [bit/s]
    json: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalsOptions:
    """Of which logs a profile is proposed, or told what they reach."""

    logs: tuple[Path, ...]
    dbc: tuple[Path, ...] = ()
    columns: str = ""
    jobs: int | None = None
    vehicle_from: str | None = None
    json: bool = False
    csv: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodeOptions:
    """What of which logs becomes which tables."""

    logs: tuple[Path, ...]
    output: Path
    force: bool
    table_format: Literal["parquet", "csv", "jsonl", "arrow"] | None
    dbc: Path | None
    match: str
    columns: str
    layout: Literal["messages", "wide"] | None
    values: Literal["numbers", "texts", "both"]
    signals: str
    begin: str | None
    end: str | None
    jobs: int | None
    strict: bool
    json: bool


def diagnosis_config(options: MeaningOptions) -> DiagnosisConfig:
    """Return how frames become results; raises ConfigError or CalibrationError."""
    if options.vehicle_file is not None and options.calibration is not None:
        raise ConfigError("a vehicle file holds a calibration: give either --vehicle-file or --calibration")
    described = options.vehicle_file or options.calibration
    calibration, gears = described_by(described, options.profile)
    broker, acknowledge, budget_mib = None, Acknowledge.BROKER, None
    if isinstance(options, DeliveryOptions):
        broker, acknowledge, budget_mib = _broker(options), Acknowledge(options.acknowledge), options.store_budget
    return DiagnosisConfig(
        vehicle=vehicle_of(options.vehicle, calibration),
        calibration=as_profiled(calibration, options.profile),
        gears=gears,
        vehicle_file=described if isinstance(described, Path) else None,
        dbc=options.dbc,
        profile=options.profile,
        is_strict=options.strict,
        columns=options.columns,
        broker=broker,
        acknowledge=acknowledge,
        budget_bytes=None if budget_mib is None else budget_mib << 20,
    )


def tls_files(options: DeliveryOptions) -> TlsFiles:
    """Return the certificates that are named; raises ConfigError if one of a pair is missing."""
    try:
        return TlsFiles(authority=options.ca, certificate=options.cert, key=options.key)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc


def _broker(options: DeliveryOptions) -> BrokerAddress | None:
    """Return where results are sent, with the certificates and the password for it.

    Raises ConfigError, also for a certificate that cannot be used: that is said now, not at the first connection.
    """
    tls = tls_files(options)
    if not options.broker:
        if tls != TlsFiles() or options.password_file is not None:
            raise ConfigError("certificates and passwords need a broker")
        return None
    try:
        address = parse_broker(options.broker, tls, options.password_file)
        if address.tls is not None:
            address.tls.context()
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    return address


def bus_config(options: LiveOptions) -> BusConfig:
    """Return which bus to listen to; raises ConfigError."""
    interface, channel = options.interface, options.channel
    if options.adapter is not None:
        if interface is not None or channel is not None:
            raise ConfigError("give either --adapter or --interface and --channel: through an adapter no bus is heard")
        if not options.active:
            raise ConfigError("--adapter needs --active: an adapter tells nothing unless it is asked")
        interface, channel = "virtual", f"adapter {uuid.uuid4()}"  # where frames of its dialogues are repeated
    return BusConfig(
        interface=interface,
        channel=channel,
        bitrate=options.bitrate,
        is_fd=options.fd,
        duration_s=options.duration,
        is_once=options.once,
        is_filtered=options.only_mapped,
        metrics=parse_listen_address(options.metrics) if options.metrics else None,
        poll=_poll(options),
        asks=options.active,
        adapter=options.adapter,
    )


def _poll(options: LiveOptions) -> PollConfig | None:
    """Return whether and how a controller is asked; raises ConfigError if that was not allowed, or for nothing."""
    if options.poll is None:
        if options.ecu or options.reply or options.description:
            raise ConfigError("--ecu, --reply and --description need --poll")
        return None
    if not options.active:
        raise ConfigError("--poll needs --active: the service sends nothing on a bus unless it is asked to")
    return PollConfig(period_s=options.poll, ecu=options.ecu, reply=options.reply, description=options.description)


def as_proposed(
    config: DiagnosisConfig, logs: Sequence[Path], is_stopped: Callable[[], bool] = never
) -> DiagnosisConfig:
    """Return the configuration; if the logs are tables without a profile, with the one that is proposed for them.

    Raises SourceError if a log cannot be read, StoppedError.
    """
    proposed = _proposed(config, logs, is_stopped)
    if proposed is None:
        return config
    calibration = config.calibration
    if calibration == nominal_calibration():  # nobody named another one
        calibration, _ = described_by(None, proposed)
    return replace(config, profile=proposed, calibration=as_profiled(calibration, proposed))


def _proposed(config: DiagnosisConfig, logs: Sequence[Path], is_stopped: Callable[[], bool]) -> Profile | None:
    """Return the profile proposed for the first log, and log it; None if that is no table, or a file explains it.

    What comes through a pipe is read once, so nothing is proposed for it.
    """
    if config.dbc is not None or config.profile is not None:
        return None
    log, columns = next(iter(logs), STANDARD_INPUT), config.columns
    if log == STANDARD_INPUT or is_folder(log) or not table_columns(log, is_stopped=is_stopped, columns=columns):
        return None
    text = proposed_profile(log, is_stopped=is_stopped, columns=columns)
    proposed = replace(profile_of(tomllib.loads(text), log), name=PROPOSED)
    _LOG.log(
        NOTICE,
        "%s is a table of signals, read with the profile proposed for it, which reaches %s; 'diag-service signals' "
        "writes that profile, for you to check and name with --profile",
        legible(log.name),
        reach_in_words(proposed.sources.keys(), knows_gears=proposed.gears is not None),
    )
    return proposed


def messages_of(options: InspectOptions | DecodeOptions, is_stopped: Callable[[], bool]) -> Sequence[Message]:
    """Return the messages of the database that is named, or of logs that are tables of signals.

    Raises what `open_database` raises.
    """
    is_j1939 = options.match == "group"
    return open_database(
        options.dbc, options.logs, is_j1939=is_j1939, is_stopped=is_stopped, columns=options.columns
    ).messages
