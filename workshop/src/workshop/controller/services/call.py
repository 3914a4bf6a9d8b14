"""What every service is given, what it gives back, and the checks that services share."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from workshop.controller.descriptions import Access
from workshop.controller.iso14229 import POSITIVE, SUPPRESS, Nrc
from workshop.controller.state import Instant, Request, ServerState
from workshop.controller.table import DiagnosticTable
from workshop.controller.values import decoded, holds


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """One request that the server has taken up."""

    table: DiagnosticTable
    state: ServerState
    moment: Instant  # as the controller takes it to be
    sensed: Instant  # as it is, whatever a client has put in its place
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

    def positive(self, data: bytes = b"", state: ServerState | None = None) -> "Outcome":
        """Return a positive response with these data, and the state that goes with it."""
        return Outcome(response=bytes([self.payload[0] + POSITIVE]) + data, state=state or self.state)

    def echoed(self, data: bytes = b"", state: ServerState | None = None) -> "Outcome":
        """Return a positive response that repeats the sub-function before its data."""
        return self.positive(bytes([self.sub_function]) + data, state)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A response and the state after it; while it is not final, 78 is sent and the response comes later."""

    response: bytes | Nrc
    state: ServerState
    is_final: bool = True


Result = Outcome | Nrc


def is_in_session(call: Call, access: Access) -> bool:
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


def locked(state: ServerState, table: DiagnosticTable) -> ServerState:
    """Return the state with security locked and without what needed it."""
    controlled = {
        number: data
        for number, data in state.controlled.items()
        if (control := table.data[number].control) is not None and not control.levels
    }
    return replace(state, unlocked=0, seed_level=0, seed=b"", controlled=controlled)


def under_control(table: DiagnosticTable, state: ServerState, moment: Instant) -> Instant:
    """Return a moment as the controller takes it to be: with the values that a client has put in place of its own."""
    if not state.controlled:
        return moment
    held = {entry.source for number in state.controlled for entry in table.data[number].fields}
    own = {source: value for source, value in moment.values.items() if source not in held}
    for number, data in state.controlled.items():
        own |= decoded(table.data[number].fields, data)
    return replace(moment, values=own)
