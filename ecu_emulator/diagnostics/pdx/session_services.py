"""Services 10, 11, 27, 28, 3E and 85 for a tool: sessions, security and what belongs to them."""

from collections.abc import Iterator
from typing import Final

from ecu_emulator.diagnostics.codes import Service as Number
from ecu_emulator.diagnostics.descriptions import Access
from ecu_emulator.diagnostics.pdx.coded_types import raw, scaled, worded
from ecu_emulator.diagnostics.pdx.dictionary import Dictionary
from ecu_emulator.diagnostics.pdx.parameters import value
from ecu_emulator.diagnostics.pdx.service import Service, access_to, simple
from ecu_emulator.diagnostics.services.sessions import (
    CODES_OFF,
    CODES_ON,
    HARD_RESET,
    KEY_OFF_ON_RESET,
    SOFT_RESET,
)
from ecu_emulator.diagnostics.table import DiagnosticTable

_RESETS: Final = {HARD_RESET: "hard reset", KEY_OFF_ON_RESET: "ignition off and on", SOFT_RESET: "soft reset"}
_TRAFFIC: Final = {
    0: "enable receiving and sending",
    1: "enable receiving, disable sending",
    2: "disable receiving, enable sending",
    3: "disable receiving and sending",
}
_MESSAGES: Final = {1: "normal messages", 2: "network management", 3: "normal messages and network management"}
_SETTINGS: Final = {CODES_ON: "trouble codes on", CODES_OFF: "trouble codes off"}


def session_services(table: DiagnosticTable, dictionary: Dictionary) -> Iterator[Service]:
    """Yield a service for each session that can be entered."""
    times = (
        value("P2", dictionary.simple("P2", scaled(2, 1.0, "ms")), 2),
        value("P2_star", dictionary.simple("P2_star", scaled(2, 10.0, "ms")), 2),
    )
    for session in table.sessions.values():
        own = Access(sessions=session.from_sessions)
        yield simple(
            f"Start session {session.name}",
            Number.SESSION_CONTROL,
            session.number,
            "SESSION",
            access_to(table, Number.SESSION_CONTROL, own),
            response=times,
            enters=session.number,
        )


def reset_services(table: DiagnosticTable, _dictionary: Dictionary) -> Iterator[Service]:
    """Yield a service for each reset."""
    for sub, name in _RESETS.items():
        access = access_to(table, Number.ECU_RESET)
        yield simple(f"Reset {name}", Number.ECU_RESET, sub, "RESET", access, resets=True)


def security_services(table: DiagnosticTable, dictionary: Dictionary) -> Iterator[Service]:
    """Yield two services for each lock: its seed, and the key to it."""
    for level in table.levels.values():
        access = access_to(table, Number.SECURITY_ACCESS, Access(sessions=level.sessions))
        number, size = Number.SECURITY_ACCESS, level.seed_bytes
        data = dictionary.simple(f"seed and key {level.name}", raw(size))
        seed, key = value("seed", data, size), value("key", data, size)
        yield simple(f"Request seed {level.name}", number, level.number, "SECURITY", access, response=(seed,))
        yield simple(
            f"Send key {level.name}",
            number,
            level.number + 1,
            "SECURITY",
            access,
            request=(key,),
            unlocks=level.number,
        )


def communication_services(table: DiagnosticTable, dictionary: Dictionary) -> Iterator[Service]:
    """Yield a service for each way in which messages are switched on or off."""
    kind = value("messages", dictionary.simple("communication type", worded(_MESSAGES, 8)), 1)
    access = access_to(table, Number.COMMUNICATION_CONTROL)
    for sub, name in _TRAFFIC.items():
        yield simple(
            f"Communication {name}", Number.COMMUNICATION_CONTROL, sub, "COMMUNICATION", access, request=(kind,)
        )


def presence_services(table: DiagnosticTable, _dictionary: Dictionary) -> Iterator[Service]:
    """Yield the service that keeps a session alive."""
    yield simple("Tester present", Number.TESTER_PRESENT, 0, "TESTERPRESENT", access_to(table, Number.TESTER_PRESENT))


def setting_services(table: DiagnosticTable, _dictionary: Dictionary) -> Iterator[Service]:
    """Yield the services that switch the updating of trouble codes."""
    for sub, name in _SETTINGS.items():
        access = access_to(table, Number.CONTROL_CODE_SETTING)
        yield simple(f"Updating of {name}", Number.CONTROL_CODE_SETTING, sub, "CONTROL", access)
