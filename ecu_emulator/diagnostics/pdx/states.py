"""Sessions and security as state charts, and which of their states a service needs."""

from typing import Final
from xml.etree.ElementTree import Element

from ecu_emulator.diagnostics.codes import DEFAULT_SESSION
from ecu_emulator.diagnostics.descriptions import Access
from ecu_emulator.diagnostics.pdx.elements import Names, listed, named, node, reference
from ecu_emulator.diagnostics.pdx.service import Service
from ecu_emulator.diagnostics.table import DiagnosticTable

LOCKED: Final = 0  # the security level of a controller that is not unlocked


class States:
    """The two state charts of a table."""

    def __init__(self, table: DiagnosticTable) -> None:
        names = Names()
        self._table = table
        self._sessions = {number: names.new(f"session {entry.name}") for number, entry in table.sessions.items()}
        self._levels = {LOCKED: names.new("locked")}
        self._levels |= {number: names.new(f"unlocked {entry.name}") for number, entry in table.levels.items()}

    def charts(self) -> Element:
        """Return both charts."""
        sessions = [
            (origin, target)
            for target, entry in self._table.sessions.items()
            for origin in self._table.sessions
            if origin in entry.from_sessions or target == DEFAULT_SESSION
        ]
        return node(
            "STATE-CHARTS",
            _chart("Session", "SESSION", self._sessions, sessions, DEFAULT_SESSION),
            _chart("Security", "SECURITY", self._levels, self._unlockings(), LOCKED),
        )

    def _unlockings(self) -> list[tuple[int, int]]:
        return [(origin, target) for target in self._levels for origin in self._levels]

    def of(self, service: Service) -> tuple[Element | None, ...]:
        """Return what a service needs of the states, and what it makes of them."""
        needed = [self._state(self._sessions[number]) for number in self._needed_sessions(service.access)]
        needed += [self._state(self._levels[number]) for number in service.access.levels]
        changed = [_transition(origin, target) for origin, target in self._changes(service)]
        return listed("PRE-CONDITION-STATE-REFS", *needed), listed("STATE-TRANSITION-REFS", *changed)

    def _needed_sessions(self, access: Access) -> tuple[int, ...]:
        return () if set(access.sessions) == set(self._sessions) and not access.levels else access.sessions

    def _changes(self, service: Service) -> list[tuple[str, str]]:
        changes = list[tuple[str, str]]()
        session = DEFAULT_SESSION if service.resets else service.enters
        if session is not None:
            origins = service.access.sessions
            changes += [(self._sessions[origin], self._sessions[session]) for origin in origins]
            changes += [(name, self._levels[LOCKED]) for name in self._levels.values()]
        if service.unlocks is not None:
            changes += [(name, self._levels[service.unlocks]) for name in self._levels.values()]
        return changes

    @staticmethod
    def _state(name: str) -> Element:
        return reference("PRE-CONDITION-STATE-REF", "STATE", name)


def _chart(name: str, semantic: str, states: dict[int, str], transitions: list[tuple[int, int]], start: int) -> Element:
    made = named("STATE-CHART", "CHART", name)
    steps = [_step(states[origin], states[target]) for origin, target in transitions]
    made.append(node("SEMANTIC", semantic))
    made.append(node("STATE-TRANSITIONS", *steps))
    made.append(node("START-STATE-SNREF", {"SHORT-NAME": states[start]}))
    made.append(node("STATES", *(named("STATE", "STATE", state) for state in states.values())))
    return made


def _step(origin: str, target: str) -> Element:
    made = named("STATE-TRANSITION", "TRANSITION", _step_name(origin, target))
    made.append(node("SOURCE-SNREF", {"SHORT-NAME": origin}))
    made.append(node("TARGET-SNREF", {"SHORT-NAME": target}))
    return made


def _transition(origin: str, target: str) -> Element:
    return reference("STATE-TRANSITION-REF", "TRANSITION", _step_name(origin, target))


def _step_name(origin: str, target: str) -> str:
    return f"{origin}_to_{target}"
