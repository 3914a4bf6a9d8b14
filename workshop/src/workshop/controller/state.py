"""The state of a controller, requests, and outcomes of services; all records are frozen."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from workshop.controller.clutches import Adaptation
from workshop.controller.descriptions import AccessRule, Values, holds
from workshop.controller.iso14229 import DEFAULT_SESSION, POSITIVE, SUPPRESS, Nrc
from workshop.controller.memory import Emissions, TroubleMemory
from workshop.controller.table import DiagnosticTable


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """One request from a transport."""

    payload: bytes
    is_functional: bool = False  # to all controllers
    client: int = 0  # 0: the CAN bus; DoIP connections have positive numbers, ELM327 clients negative ones


@dataclass(frozen=True, slots=True, kw_only=True)
class Instant:
    """Time, values of the vehicle and random bytes at one instant."""

    t_s: float  # of a clock that never goes back
    values: Values
    chance: bytes = b""  # fresh random bytes, as many as the longest seed has


@dataclass(frozen=True, slots=True, kw_only=True)
class Communication:
    """Which messages are still sent and received, service 28; of network management there are none."""

    sends_normal: bool = True
    receives_normal: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutineRun:
    """A routine that was started."""

    ends_s: float  # at the latest
    is_running: bool = True
    was_stopped: bool = False
    failed_nrc: int = 0  # why the vehicle could not do it; 0: it could, or still may
    options: bytes = b""
    results: bytes = b""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waiting:
    """A request whose final response comes later; until then 78 is repeated."""

    request: Request
    routine: int
    again_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A part of a datum within a defined one."""

    source: int
    start: int  # from 0
    size_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptState:
    """The part of the state that survives a restart; fault detection counters do not."""

    memory: TroubleMemory
    emissions: Emissions = field(default_factory=Emissions)
    written: Mapping[int, bytes] = field(default_factory=dict)
    wrong_keys: Mapping[int, int] = field(default_factory=dict)  # by security level
    adaptation: Adaptation | None = None  # None: nothing was ever adapted or cleared

    @property
    def members(self) -> dict[str, Any]:
        """Its members by name."""
        return {member.name: getattr(self, member.name) for member in fields(KeptState)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerState(KeptState):
    """One controller between two requests."""

    session: int = DEFAULT_SESSION
    holder: int = 0  # client who entered the session, unless it is the default one
    heard_s: float = 0.0  # time of the last request, at which S3 began
    unlocked: int = 0  # security level; 0 none
    seed_level: int = 0  # security level of the seed that waits for its key
    seed: bytes = b""
    locked_until_s: Mapping[int, float] = field(default_factory=dict)
    are_codes_updated: bool = True
    communication: Communication = field(default_factory=Communication)
    defined: Mapping[int, tuple[Piece, ...]] = field(default_factory=dict)
    routines: Mapping[int, RoutineRun] = field(default_factory=dict)
    waiting: Waiting | None = None
    asleep_until_s: float = 0.0  # after a reset

    @property
    def kept(self) -> KeptState:
        """The part that is saved."""
        records = {code: replace(record, detection_counter=0) for code, record in self.memory.records.items()}
        return KeptState(**{**self.members, "memory": replace(self.memory, records=records)})

    def keeps_same_as(self, other: KeptState) -> bool:
        """Return whether the saved members are identical objects: a cheap test for "nothing to save"."""
        theirs = other.members
        return all(mine is theirs[name] for name, mine in self.members.items())


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """A response or none, and the state after it."""

    payload: bytes | None
    state: ServerState
    withheld: bytes | None = None  # suppressed response; it is sent if the transport has sent 78 before

    def response(self, *, was_promised: bool) -> bytes | None:
        """Return the response to send; after a 78 that includes a suppressed one (ISO 14229-1)."""
        return self.withheld if was_promised and self.payload is None else self.payload


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """One request in progress."""

    table: DiagnosticTable
    state: ServerState
    moment: Instant
    request: Request
    is_guest: bool = False  # another client holds the session; this one is answered as in the default session

    @property
    def payload(self) -> bytes:
        """The request's bytes, the service's identifier first."""
        return self.request.payload

    @property
    def sub_function(self) -> int:
        """The sub-function, without the bit that suppresses a positive response."""
        return self.payload[1] & ~SUPPRESS

    def positive(self, data: bytes = b"", state: ServerState | None = None) -> "ServiceOutcome":
        """Return a positive response with these data, and the state that goes with it."""
        return ServiceOutcome(response=bytes([self.payload[0] + POSITIVE]) + data, state=state or self.state)

    def echoed(self, data: bytes = b"", state: ServerState | None = None) -> "ServiceOutcome":
        """Return a positive response that repeats the sub-function before its data."""
        return self.positive(bytes([self.sub_function]) + data, state)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceOutcome:
    """A response and the state after it; 78 is sent in place of one that is not final."""

    response: bytes | Nrc
    state: ServerState
    is_final: bool = True


Result = ServiceOutcome | Nrc


def is_in_session(call: Call, access: AccessRule) -> bool:
    """Return whether the active session allows it."""
    return call.state.session in access.sessions


def is_unlocked(state: ServerState, levels: tuple[int, ...]) -> bool:
    """Return whether no security level is needed, or one of these is unlocked."""
    return not levels or state.unlocked in levels


def unmet(call: Call, conditions: Iterable[str]) -> Nrc | None:
    """Return the response code of the first condition that the vehicle violates, None if there is none."""
    for name in conditions:
        condition = call.table.conditions[name]
        if not holds(condition, call.moment.values):
            return Nrc(condition.nrc)
    return None


def unmet_by_service(call: Call) -> Nrc | None:
    """Return the response code of the first violated condition of this service, None if there is none."""
    return unmet(call, call.table.services[call.payload[0]].conditions)


def locked(state: ServerState) -> ServerState:
    """Return the state with security locked."""
    return replace(state, unlocked=0, seed_level=0, seed=b"")
