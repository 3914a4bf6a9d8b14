"""What an entity remembers of its TCP connections, and what it does next; nothing here is ever changed in place."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from ecu_emulator.diagnostics.table import DoipEntity

MORE_CONNECTIONS: Final = 8  # beside those that may be activated: each is told that it may not, or closed in 2 s


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """A routing activation that waits for other testers to say that they are alive."""

    tester: int
    version: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Socket:
    """One TCP connection."""

    opened_s: float
    used_s: float  # when data came or went
    received: bytes = b""  # not yet a whole message
    skip_bytes: int = 0  # of a message that is passed over
    version: int = 0  # that its tester speaks
    tester: int | None = None  # its address, once routing is activated
    alive_until_s: float | None = None  # its tester was asked whether it is alive; closed then
    wish: Wish | None = None
    waiting_count: int = 0  # requests that the controller has not answered


@dataclass(frozen=True, slots=True, kw_only=True)
class Send:
    """Bytes for a connection."""

    number: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Close:
    """A connection that ends once what was said before has gone out."""

    number: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """A request for the controller."""

    number: int
    payload: bytes
    is_functional: bool


Action = Send | Close | Ask


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """All connections, and what is to be done since the step before."""

    sockets: Mapping[int, Socket]
    actions: tuple[Action, ...] = ()

    def changed(self, number: int, **values: Any) -> "Step":  # noqa: ANN401 - the members of a socket
        return replace(self, sockets={**self.sockets, number: replace(self.sockets[number], **values)})

    def sending(self, number: int, data: bytes, t_s: float) -> "Step":
        """Return the step with something said to one tester."""
        return replace(self.changed(number, used_s=t_s), actions=(*self.actions, Send(number=number, data=data)))

    def asking(self, ask: Ask) -> "Step":
        """Return the step with a request handed to the controller."""
        more = self.sockets[ask.number].waiting_count + 1
        return replace(self.changed(ask.number, waiting_count=more), actions=(*self.actions, ask))

    def closing(self, number: int) -> "Step":
        """Return the step without one connection."""
        return replace(self.forgetting(number), actions=(*self.actions, Close(number=number)))

    def forgetting(self, number: int) -> "Step":
        """Return the step without a connection that its tester has closed."""
        return replace(self, sockets={key: socket for key, socket in self.sockets.items() if key != number})

    def done(self) -> "Step":
        """Return the step with nothing left to do."""
        return replace(self, actions=())


def active_count(sockets: Mapping[int, Socket]) -> int:
    """Return how many connections have their routing activated."""
    return sum(socket.tester is not None for socket in sockets.values())


def most_connections(entity: DoipEntity) -> int:
    """Return how many connections are accepted at all."""
    return entity.most_sockets + MORE_CONNECTIONS
