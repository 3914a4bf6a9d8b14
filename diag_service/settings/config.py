"""What a run is to do, checked once: the command line's words become values, or a ConfigError.

Tables of signals of which nobody says what their columns mean are read as is proposed for them.
"""

import os
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clutch_model.calibration import Calibration, TorqueSource, nominal_calibration
from diag_service.delivery import Acknowledge
from diag_service.diagnosis.columns import GearRatios
from diag_service.errors import ConfigError
from diag_service.mapping.interpretation import Interpretation, interpret
from diag_service.mapping.mapped_messages import is_of_lockup
from diag_service.mapping.profile import Profile, find_profile
from diag_service.mapping.vehicle_file import Described, read_description
from fleet_contract import is_vehicle
from fleet_link import AddressError, BrokerAddress, TlsFiles, parse_broker

if TYPE_CHECKING:
    import can

UNNAMED_VEHICLE = "vehicle"  # what a vehicle is called that nobody names
SMALLEST_BUDGET_BYTES = 1 << 20
SHORTEST_POLL_S = 1.0
_LOCKUP = Path("lockup")  # profile and description of an automatic
_LOOPBACK = "127.0.0.1"
PROPOSED = "proposed"  # what a profile is called that nobody named and that is proposed for a table


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisConfig:
    """How frames become results; the same for a bus and for logs. ``None`` means what ships with the service."""

    vehicle: str
    calibration: Calibration
    dbc: Path | None = None
    profile: Path | Profile | None = None
    vehicle_file: Path | None = None
    gears: GearRatios | None = None  # of the vehicle file
    broker: BrokerAddress | None = None
    is_strict: bool = False  # of logs: stop at the first fault
    columns: str = ""  # of logs that are tables: which is which; empty: their header says
    acknowledge: Acknowledge = Acknowledge.BROKER
    budget_bytes: int | None = None  # of the store; None: no limit

    def interpretation(self) -> Interpretation:
        """Return what frames mean; raises ConfigError."""
        usual = _LOCKUP if self.dbc is None and self.calibration.converter is not None else None
        meaning = interpret(self.dbc, self.profile or usual)
        return meaning.with_gears(self.gears, *([] if self.vehicle_file is None else [self.vehicle_file]))

    def __post_init__(self) -> None:
        if self.budget_bytes is not None and self.budget_bytes < SMALLEST_BUDGET_BYTES:
            raise ConfigError(f"the disk budget must be at least {SMALLEST_BUDGET_BYTES} bytes")
        if self.broker is None and self.acknowledge is Acknowledge.BACKEND:
            raise ConfigError("without a broker no backend can acknowledge anything")
        if self.calibration.vehicle not in {None, self.vehicle}:
            raise ConfigError(
                f"the calibration is of vehicle {self.calibration.vehicle}, not of {self.vehicle} (--vehicle); "
                "a file without its line 'vehicle' is for all"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ListenAddress:
    """Where to serve."""

    host: str
    port: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PollConfig:
    """How often a controller is asked for its trouble codes, and who it is."""

    period_s: float
    ecu: str | None  # as on the command line
    reply: str | None
    description: Path | None
    bus: "can.BusABC | None" = None  # open, an end of its own; None: the diagnosed bus is opened once more

    def __post_init__(self) -> None:
        if not SHORTEST_POLL_S <= self.period_s < float("inf"):
            raise ConfigError(f"--poll must be at least {SHORTEST_POLL_S:g} s, got {self.period_s:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class BusConfig:
    """Which bus to listen to; ``None`` means what python-can's own configuration says."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    is_fd: bool
    duration_s: float | None = None
    is_filtered: bool = False  # whether the kernel discards what no mapped signal needs
    metrics: ListenAddress | None = None  # where to serve metrics and health checks
    poll: PollConfig | None = None  # None: trouble codes are not asked for
    asks: bool = False  # whether signals are asked for that the profile says are to be
    adapter: str | None = None  # through which, in place of a bus; what is said there is said on the named one as well

    def __post_init__(self) -> None:
        if self.bitrate is not None and self.bitrate <= 0:
            raise ConfigError(f"the bit rate must be > 0, got {self.bitrate}")
        if self.duration_s is not None and not 0.0 < self.duration_s < float("inf"):
            raise ConfigError(f"the duration must be > 0 s, got {self.duration_s:g}")


def check_vehicle(vehicle: str) -> str:
    """Return a vehicle id that is fit for an MQTT topic and a file name.

    Raises ConfigError if it has other characters than letters, digits, ``_``, ``.`` and ``-``, or is longer than 64.
    """
    if not is_vehicle(vehicle):
        raise ConfigError(
            f"{vehicle!r} is not a vehicle id: up to 64 letters, digits, '_', '.' or '-', not starting with '.' or '-'"
        )
    return vehicle


def described_by(named: Calibration | Path | None, profile: Path | Profile | None) -> Described:
    """Return what a description says; if none is named, the shipped one of the transmission that the profile is of."""
    if named is None:
        is_lockup = profile is not None and is_of_lockup(find_profile(profile).sources.keys())
        named = _LOCKUP if is_lockup else nominal_calibration()
    return Described(named, None) if isinstance(named, Calibration) else read_description(named)


def as_profiled(calibration: Calibration, profile: Path | Profile | None) -> Calibration:
    """Return a calibration that knows where the engine's torque comes from; raises ConfigError."""
    told = TorqueSource.MEASURED if profile is None else find_profile(profile).torque
    return calibration.with_torque(told if told.is_modelled else calibration.torque)


def adapter_bus() -> tuple[str, str]:
    """Return interface and channel of a new bus of this process, on which dialogues through an adapter are said."""
    return "virtual", f"adapter {uuid.uuid4()}"


@dataclass(frozen=True, slots=True, kw_only=True)
class MeaningOptions:
    """What frames mean and whose they are, as a command line says it."""

    vehicle: str | None = None
    dbc: Path | None = None
    profile: Path | None = None
    calibration: Path | None = None
    vehicle_file: Path | None = None
    columns: str = ""
    strict: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class DeliveryOptions(MeaningOptions):
    """The same, and where results are kept and sent."""

    store: Path | None = None
    store_budget: int | None = None
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
    duration: float | None = None
    metrics: str | None = None
    poll: float | None = None
    adapter: str | None = None
    active: bool = False
    ecu: str | None = None
    reply: str | None = None
    description: Path | None = None
    json: bool = False


def bus_config(options: LiveOptions) -> BusConfig:
    """Return which bus to listen to; raises ConfigError."""
    interface, channel = options.interface, options.channel
    if options.adapter is not None:
        if interface is not None or channel is not None:
            raise ConfigError("give either --adapter or --interface and --channel: through an adapter no bus is heard")
        if not options.active:
            raise ConfigError("--adapter needs --active: an adapter tells nothing unless it is asked")
        interface, channel = adapter_bus()
    return BusConfig(
        interface=interface,
        channel=channel,
        bitrate=options.bitrate,
        is_fd=options.fd,
        duration_s=options.duration,
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


def vehicle_of(named: str | None, calibration: Calibration) -> str:
    """Return the id of the vehicle: the one that was named, or else that of its calibration."""
    if named is not None:
        return check_vehicle(named)
    try:
        return check_vehicle(UNNAMED_VEHICLE if calibration.vehicle is None else calibration.vehicle)
    except ConfigError as exc:
        raise ConfigError(f"the calibration's vehicle: {exc}") from exc


def broker_of(
    url: str | None, ca: Path | None, cert: Path | None, key: Path | None, password_file: Path | None
) -> BrokerAddress | None:
    """Return where results are sent, with the certificates and the password for it."""
    try:
        tls = TlsFiles(authority=ca, certificate=cert, key=key)
        if url:
            return parse_broker(url, tls, password_file)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    if tls != TlsFiles() or password_file is not None:
        raise ConfigError("certificates and passwords need a broker")
    return None


def parse_listen_address(text: str) -> ListenAddress:
    """Return the address that ``[HOST:]PORT`` names; without a host it is this machine's own.

    Raises ConfigError if the text is no such address.
    """
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 0xFFFF:
        raise ConfigError(f"the metrics address must be [HOST:]PORT, got {text!r}")
    return ListenAddress(host=host.strip("[]") or _LOOPBACK, port=int(port))


def default_store(vehicle: str) -> Path:
    """Return where a live service keeps its results: the user's state directory; raises ConfigError without one."""
    home = os.environ.get("XDG_STATE_HOME", "")
    try:
        state = Path(home) if Path(home).is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError:  # a container's user may have no home
        raise ConfigError("this user has no home folder to keep results in: name a file with --store") from None
    return state / "clutchdiag" / f"{vehicle}.sqlite"
