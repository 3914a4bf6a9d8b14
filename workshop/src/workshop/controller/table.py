"""What a controller can be asked: everything that it answers follows from this table."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from ecu_emulator.errors import ConfigError
from workshop.controller import descriptions
from workshop.controller.iso14229 import DEFAULT_SESSION, Service

PERIODIC_PAGE: Final = 0xF2  # upper byte of data that can be sent periodically, ISO 14229-1 annex C
_FRAME_BYTES: Final = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Addressing:
    """CAN identifiers: requests to this controller, its responses, requests to all controllers."""

    request_id: int
    response_id: int
    functional_id: int

    def __post_init__(self) -> None:
        ids = (self.request_id, self.response_id, self.functional_id)
        _check(
            max(ids) <= 0x1FFFFFFF and len(set(ids)) == len(ids), "three identifiers, of 29 bits at most, must differ"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Transport:
    """How ISO-TP behaves where the standard leaves a choice."""

    padding: int | None = None  # every frame is filled up to eight bytes with it; without it short ones are sent
    block_size: int = 8  # frames that a client may send before it asks again; 0 all
    separation_time: int = 0  # STmin that is asked of clients, as coded on the wire
    own_address: int | None = None  # extended addressing: the byte before everything that is sent to this controller
    tester_address: int = 0xF1  # likewise in responses
    all_address: int = 0xFE  # likewise in requests to all

    def __post_init__(self) -> None:
        for name in ("padding", "block_size", "separation_time", "own_address", "tester_address", "all_address"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 0xFF:
                raise ConfigError(f"{name} must be 0..0xFF, got {value}")


@dataclass(frozen=True, slots=True, kw_only=True)
class DoipEntity:
    """What a controller is on an IP network (ISO 13400-2); addresses and times as the standard has them."""

    logical_address: int = 0x1011
    functional_address: int = 0xE400  # of requests to all controllers
    first_tester: int = 0x0E00  # addresses that testers may have
    last_tester: int = 0x0FFF
    activation_types: tuple[int, ...] = (0x00, 0x01)  # default, and that of legislated diagnosis
    eid: int = 0x020000001011  # of the entity; a MAC address that is administered locally
    gid: int = 0x020000001011  # of its group
    version: int = 0x03  # said where the tester has not said which it speaks
    most_sockets: int = 4
    most_request_bytes: int = 4095
    initial_inactivity_s: float = 2.0  # T_TCP_Initial_Inactivity: until routing is activated
    general_inactivity_s: float = 300.0  # T_TCP_General_Inactivity
    alive_check_s: float = 0.5  # T_TCP_Alive_Check
    announce_wait_s: float = 0.5  # A_DoIP_Announce_Wait: the longest random pause before one says who one is
    announce_interval_s: float = 0.5
    announce_count: int = 3

    def __post_init__(self) -> None:
        numbers = (self.logical_address, self.functional_address, self.first_tester, self.last_tester)
        _check(min(numbers) >= 1 and max(numbers) <= 0xFFFF, "addresses must be 1..0xFFFF")
        _check(self.first_tester <= self.last_tester, "first_tester must not be above last_tester")
        own = (self.logical_address, self.functional_address)
        _check(
            own[0] != own[1] and not any(self.first_tester <= number <= self.last_tester for number in own),
            "logical_address and functional_address must differ from each other and from those of testers",
        )
        _check(max(self.activation_types, default=0) <= 0xFF, "activation_types must be 0..0xFF")
        _check(max(self.eid, self.gid) < 1 << 48, "eid and gid must have six bytes")
        _check(self.version in {0x02, 0x03}, "version must be 2 (ISO 13400-2:2012) or 3 (:2019)")
        _check(1 <= self.most_sockets <= 0xFF, "most_sockets must be 1..255")
        _check(8 <= self.most_request_bytes <= 4095, "most_request_bytes must be 8..4095")
        _check(self.announce_count <= 10, "announce_count must be at most 10")
        for name in ("initial_inactivity_s", "general_inactivity_s", "alive_check_s", "announce_interval_s"):
            _check(0.0 < getattr(self, name) <= 3600.0, f"{name} must be above 0 and at most 3600 s")
        _check(0.0 <= self.announce_wait_s <= 10.0, "announce_wait_s must be 0..10 s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Times of ISO 14229-2."""

    p2_s: float
    p2_star_s: float
    s3_s: float
    reset_s: float  # from a reset until the controller listens again
    least_answer_s: float = 0.0  # that an answer takes, drawn evenly up to the next
    most_answer_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Periodic:
    """How data are sent again and again (service 2A): each in one frame with an identifier of its own."""

    response_id: int
    slow_s: float
    medium_s: float
    fast_s: float
    most: int  # data at once

    def __post_init__(self) -> None:
        _check(0 <= self.response_id <= 0x1FFFFFFF, "periodic.response_id has 29 bits at most")
        periods = (self.fast_s, self.medium_s, self.slow_s)
        _check(self.fast_s >= 0.01 and periods == tuple(sorted(periods)), "0.01 <= fast_s <= medium_s <= slow_s")
        _check(self.slow_s <= 3600.0, "periodic.slow_s must be at most 3600 s")
        _check(1 <= self.most <= 0x100, "periodic.most must be 1..256")


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much one request may ask for."""

    most_data: int  # identifiers in one request
    most_response_bytes: int
    most_pieces: int  # of data identifiers that the client defined, in all

    def __post_init__(self) -> None:
        _check(self.most_data >= 1, "most_data must be at least 1")
        _check(8 <= self.most_response_bytes <= 4095, "most_response_bytes must be 8..4095, what ISO-TP carries")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchLimits:
    """What the controller's own monitors and its adaptation allow of a clutch; all [C]."""

    most_temperature_k: float = 423.15  # 150 degC, of the pack as the controller computes it
    most_touch_change_pa: float = 0.25e5  # of an adapted touch point from that of the type: five standard deviations

    def __post_init__(self) -> None:
        _check(273.15 <= self.most_temperature_k <= 1273.15, "clutches.most_temperature_k must be 273.15..1273.15 K")
        _check(0.0 < self.most_touch_change_pa <= 0.3e5, "clutches.most_touch_change_pa must be above 0, at most 0.3e5")


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosticTable:
    """Everything a controller can be asked, by number."""

    name: str
    addressing: Addressing
    transport: Transport
    timing: Timing
    limits: Limits
    sessions: Mapping[int, descriptions.Session]
    levels: Mapping[int, descriptions.SecurityLevel]
    services: Mapping[int, descriptions.ServiceAccess]
    conditions: Mapping[str, descriptions.Condition]
    data: Mapping[int, descriptions.Datum]
    routines: Mapping[int, descriptions.Routine]
    troubles: Mapping[int, descriptions.Trouble]
    extended: Mapping[int, descriptions.ExtendedRecord]
    snapshot: tuple[int, ...]  # data kept with every trouble code that names none itself
    obd: descriptions.Obd | None = None
    doip: DoipEntity = field(default_factory=DoipEntity)
    periodic: Periodic | None = None
    clutches: ClutchLimits = field(default_factory=ClutchLimits)

    def __post_init__(self) -> None:
        self._check_periodic()
        _check(DEFAULT_SESSION in self.sessions, "sessions must have number 1, the default session")
        for where, numbers, most in (
            ("session", self.sessions, 0x7E),
            ("service", self.services, 0xFF),
            ("data", self.data, 0xFFFF),
            ("routine", self.routines, 0xFFFF),
        ):
            highest = max(numbers, default=0)
            _check(highest <= most, f"{where} 0x{highest:X} is above 0x{most:X}")
        for access, where in self._accesses():
            _check_known(access.sessions, self.sessions, f"{where}: session")
            _check_known(access.levels, self.levels, f"{where}: security level")
            _check_known(access.conditions, self.conditions, f"{where}: condition")
        for routine in self.routines.values():
            _check_known(routine.held_conditions, self.conditions, f"routine {routine.name}: condition")
        for level in self.levels.values():
            _check_known(level.sessions, self.sessions, f"security level {level.name}: session")
        if self.obd is not None:
            _check_known(self.obd.clear_conditions, self.conditions, "obd_clear_conditions: condition")
            codes = {trouble.code: trouble for trouble in self.troubles.values()}
            for monitor in self.obd.monitors.values():
                _check_known((monitor.code,), codes, f"monitor 0x{monitor.number:02X}: trouble code")
            for info in self.obd.infos.values():
                _check_known(
                    () if info.data is None else (info.data,), self.data, f"vehicle information {info.name}: data"
                )
        for trouble in self.troubles.values():
            _check_known(self.snapshot_of(trouble), self.data, f"trouble code {trouble.code}: data")
            _check_known(self.extended_of(trouble), self.extended, f"trouble code {trouble.code}: extended record")
        for name, most_s in (("p2_s", 65.0), ("p2_star_s", 600.0), ("s3_s", 600.0)):  # two bytes of ms, and of 10 ms
            time_s = getattr(self.timing, name)
            _check(0.0 < time_s <= most_s, f"timing.{name} must be above 0 and at most {most_s:g} s, got {time_s}")
        least_s, most_s = self.timing.least_answer_s, self.timing.most_answer_s
        _check(0.0 <= least_s <= most_s < self.timing.p2_s, "0 <= timing.least_answer_s <= most_answer_s < p2_s")

    @property
    def most_periodic_bytes(self) -> int:
        """Length of the data of a frame of service 2A, after the identifier's lower byte."""
        return _FRAME_BYTES - 1 - (self.transport.own_address is not None)

    def _check_periodic(self) -> None:
        if self.periodic is None:
            _check(Service.READ_PERIODICALLY not in self.services, "service 0x2A is there, but not [periodic]")
            return
        ids = self.addressing
        others = {ids.request_id, ids.response_id, ids.functional_id}
        _check(self.periodic.response_id not in others, "periodic.response_id must differ from the other identifiers")
        for number, datum in self.data.items():
            if number >> 8 == PERIODIC_PAGE:
                _check(
                    datum.size_bytes <= self.most_periodic_bytes,
                    f"data {datum.name}: what is sent periodically has at most {self.most_periodic_bytes} bytes",
                )

    def has_obd(self, profile: descriptions.Profile) -> bool:
        """Return whether OBD is spoken in this way."""
        return self.obd is not None and self.obd.profile is profile

    def snapshot_of(self, trouble: descriptions.Trouble) -> tuple[int, ...]:
        """Return the data identifiers of a trouble code's snapshots."""
        return self.snapshot if trouble.snapshot is None else trouble.snapshot

    def extended_of(self, trouble: descriptions.Trouble) -> tuple[int, ...]:
        """Return the numbers of a trouble code's extended records."""
        numbers = tuple(self.extended) if trouble.extended is None else trouble.extended
        return tuple(
            number for number in numbers if trouble.lights_lamp or self.extended.get(number) is not descriptions.IN_USE
        )

    def _accesses(self) -> Iterable[tuple[descriptions.Access | descriptions.ServiceAccess, str]]:
        for service in self.services.values():
            yield service, f"service {service.name}"
        for datum in self.data.values():
            for access in (datum.read, datum.write, datum.control):
                if access is not None:
                    yield access, f"data {datum.name}"
        for routine in self.routines.values():
            yield routine.access, f"routine {routine.name}"


def _check_known(
    names: Iterable[object], known: Mapping[object, object] | Mapping[int, object] | Mapping[str, object], where: str
) -> None:
    for name in names:
        _check(name in known, f"{where} {name if isinstance(name, str) else f'0x{name:02X}'} is not described")


def _check(holds: bool, message: str) -> None:  # noqa: FBT001 - reads as a sentence at the call
    if not holds:
        raise ConfigError(message)
