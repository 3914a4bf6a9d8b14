"""What a run is to do, as values that were checked once."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from canlog.files import replacing
from clutch_model.calibration import Calibration, TorqueSource, nominal_calibration
from diag_service.delivery import Acknowledge
from diag_service.diagnosis.columns import GearRatios
from diag_service.errors import ConfigError
from diag_service.mapping.interpretation import Interpretation, interpret
from diag_service.mapping.mapped_messages import is_of_lockup
from diag_service.mapping.profile import Profile, find_profile
from diag_service.mapping.vehicle_file import Described, read_description
from fleet_contract import is_vehicle
from fleet_link import BrokerAddress

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
    is_once: bool = False  # whether the run ends with the bus, instead of waiting for its return
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


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all; raises ConfigError if the disk does not take it."""
    with replacing(path, ConfigError) as part:
        part.write_text(text, encoding="utf-8")
        part.replace(path)


def described_by(named: Calibration | Path | None, profile: Path | Profile | None) -> Described:
    """Return calibration and gears of a vehicle file; without one those shipped for the profile's transmission."""
    if named is None:
        is_lockup = profile is not None and is_of_lockup(find_profile(profile).sources.keys())
        named = _LOCKUP if is_lockup else nominal_calibration()
    return Described(named, None) if isinstance(named, Calibration) else read_description(named)


def as_profiled(calibration: Calibration, profile: Path | Profile | None) -> Calibration:
    """Return a calibration with the source of engine torque that the profile has; raises ConfigError."""
    torque = TorqueSource.MEASURED if profile is None else find_profile(profile).torque
    return calibration.with_torque(torque if torque.is_modelled else calibration.torque)


def vehicle_of(named: str | None, calibration: Calibration) -> str:
    """Return the id of the vehicle: the one that was named, or else that of its calibration."""
    if named is not None:
        return check_vehicle(named)
    try:
        return check_vehicle(UNNAMED_VEHICLE if calibration.vehicle is None else calibration.vehicle)
    except ConfigError as exc:
        raise ConfigError(f"the calibration's vehicle: {exc}") from exc


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
