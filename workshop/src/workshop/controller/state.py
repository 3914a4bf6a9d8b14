"""What a controller remembers of its clients, what a service is given and gives back; nothing is changed in place."""

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
    """One request as the transport heard it."""

    payload: bytes
    is_functional: bool = False  # to all controllers
    client: int = 0  # who asks: 0 whoever is on the CAN bus, others as their transport numbers them


@dataclass(frozen=True, slots=True, kw_only=True)
class Instant:
    """What the server may know of the world at one instant: the time, the vehicle, and some chance for a seed."""

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
    """A part of a datum, of which a client made a datum of its own."""

    source: int
    start: int  # from 0
    size_bytes: int
    client: int = 0  # who made it


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodicRun:
    """A datum that is sent again and again."""

    period_s: float
    due_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptState:
    """What outlives a restart; whether an operation cycle's test is under way does not."""

    memory: TroubleMemory
    emissions: Emissions = field(default_factory=Emissions)
    written: Mapping[int, bytes] = field(default_factory=dict)
    wrong_keys: Mapping[int, int] = field(default_factory=dict)  # by security level
    adaptation: Adaptation | None = None  # None: nothing was ever adapted or cleared

    @property
    def members(self) -> dict[str, Any]:
        """All of it by name."""
        return {one.name: getattr(self, one.name) for one in fields(KeptState)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerState(KeptState):
    """One controller between two requests."""

    session: int = DEFAULT_SESSION
    holder: int = 0  # the client who entered it, if it is not the default session
    heard_s: float = 0.0  # when S3 began
    unlocked: int = 0  # security level; 0 none
    seed_level: int = 0  # for which a seed was given and no key yet
    seed: bytes = b""
    locked_until_s: Mapping[int, float] = field(default_factory=dict)
    are_codes_updated: bool = True
    communication: Communication = field(default_factory=Communication)
    defined: Mapping[int, tuple[Piece, ...]] = field(default_factory=dict)
    periodic: Mapping[int, PeriodicRun] = field(default_factory=dict)  # by data identifier
    routines: Mapping[int, RoutineRun] = field(default_factory=dict)
    waiting: Waiting | None = None
    asleep_until_s: float = 0.0  # after a reset

    @property
    def kept(self) -> KeptState:
        """What is kept of it."""
        records = {code: replace(record, detection_counter=0) for code, record in self.memory.records.items()}
        return KeptState(**{**self.members, "memory": replace(self.memory, records=records)})

    def keeps_as(self, other: KeptState) -> bool:
        """Return whether the same is kept of another one, at a glance."""
        theirs = other.members
        return all(mine is theirs[name] for name, mine in self.members.items())


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What a server does with a request or with time: a response or none, and its state after it."""

    payload: bytes | None
    state: ServerState
    withheld: bytes | None = None  # kept back; who was told to wait (78) by the transport hears it all the same

    def response(self, *, was_promised: bool) -> bytes | None:
        """Return what is sent, if the transport has said or not that a response comes later (78)."""
        return self.withheld if was_promised and self.payload is None else self.payload


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """One request that the server has taken up."""

    table: DiagnosticTable
    state: ServerState
    moment: Instant
    request: Request
    is_guest: bool = False  # another client holds a session; this one is answered as in the default session

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
    """A response and the state after it; while it is not final, 78 is sent and the response comes later."""

    response: bytes | Nrc
    state: ServerState
    is_final: bool = True


Result = ServiceOutcome | Nrc


def is_in_session(call: Call, access: AccessRule) -> bool:
    """Return whether something may be done in the active session."""
    return call.state.session in access.sessions


def is_unlocked(state: ServerState, levels: tuple[int, ...]) -> bool:
    """Return whether no security is needed, or the right one is unlocked."""
    return not levels or state.unlocked in levels


def unmet(call: Call, conditions: Iterable[str]) -> Nrc | None:
    """Return what is wrong with the vehicle: the response of the first condition that does not hold."""
    for name in conditions:
        condition = call.table.conditions[name]
        if not holds(condition, call.moment.values):
            return Nrc(condition.nrc)
    return None


def unmet_by_service(call: Call) -> Nrc | None:
    """Return what is wrong with the vehicle for this service."""
    return unmet(call, call.table.services[call.payload[0]].conditions)


def locked(state: ServerState) -> ServerState:
    """Return the state with security locked."""
    return replace(state, unlocked=0, seed_level=0, seed=b"")
