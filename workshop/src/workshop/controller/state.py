"""What a controller remembers of its clients; nothing here is ever changed in place."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from workshop.controller.clutches import Adaptation
from workshop.controller.iso14229 import DEFAULT_SESSION
from workshop.controller.memory import Emissions, TroubleMemory
from workshop.controller.values import Values


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
class ServerState:
    """One controller between two requests."""

    memory: TroubleMemory  # kept over a restart, as the next four
    emissions: Emissions = field(default_factory=Emissions)
    written: Mapping[int, bytes] = field(default_factory=dict)
    wrong_keys: Mapping[int, int] = field(default_factory=dict)  # by security level
    adaptation: Adaptation | None = None  # None: nothing was ever adapted or cleared
    session: int = DEFAULT_SESSION
    holder: int = 0  # the client who entered it, if it is not the default session
    heard_s: float = 0.0  # when S3 began
    unlocked: int = 0  # security level; 0 none
    seed_level: int = 0  # for which a seed was given and no key yet
    seed: bytes = b""
    locked_until_s: Mapping[int, float] = field(default_factory=dict)
    are_codes_updated: bool = True
    communication: Communication = field(default_factory=Communication)
    controlled: Mapping[int, bytes] = field(default_factory=dict)
    defined: Mapping[int, tuple[Piece, ...]] = field(default_factory=dict)
    periodic: Mapping[int, PeriodicRun] = field(default_factory=dict)  # by data identifier
    routines: Mapping[int, RoutineRun] = field(default_factory=dict)
    waiting: Waiting | None = None
    asleep_until_s: float = 0.0  # after a reset


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What a server does with a request or with time: a response or none, and its state after it."""

    payload: bytes | None
    state: ServerState
    withheld: bytes | None = None  # kept back; who was told to wait (78) by the transport hears it all the same

    def response(self, *, was_promised: bool) -> bytes | None:
        """Return what is sent, if the transport has said or not that a response comes later (78)."""
        return self.withheld if was_promised and self.payload is None else self.payload
