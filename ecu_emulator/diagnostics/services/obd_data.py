"""Values of OBD, for both of its profiles: parameters, the freeze frame, vehicle information."""

from typing import Final

from ecu_emulator.diagnostics.codes import Status
from ecu_emulator.diagnostics.descriptions import BLOCK, Pid, Profile, VehicleInfo, supported
from ecu_emulator.diagnostics.memory import FrozenPids, emission_codes, is_lamp_on
from ecu_emulator.diagnostics.state import Instant, ServerState
from ecu_emulator.diagnostics.table import DiagnosticTable
from ecu_emulator.diagnostics.values import Value, Values, encode

_LAMP: Final = 0x80
_MOST_CODES: Final = 0x7F
_COMPONENTS: Final = 0x04  # monitored all the time, and therefore always ready
PID_DATA: Final = 0xF400  # data identifiers of SAE J1979-2
INFO_DATA: Final = 0xF800


def odometer_m(moment: Instant) -> float | None:
    """Return the distance that the vehicle has driven [m], None if it does not say."""
    distance_m = moment.values.get("odometer_m")
    return distance_m if isinstance(distance_m, int | float) else None


def pid_data(pid: Pid, table: DiagnosticTable, state: ServerState, moment: Instant) -> bytes:
    """Return what a parameter holds now."""
    return pid.initial_bytes or _encoded(pid, _with_obd(table, state, moment))


def frozen_pids(table: DiagnosticTable, state: ServerState, moment: Instant) -> FrozenPids:
    """Return the parameters that a freeze frame keeps."""
    if table.obd is None:
        return ()
    values = _with_obd(table, state, moment)
    return tuple(
        (pid.number, pid.initial_bytes or _encoded(pid, values)) for pid in table.obd.pids.values() if pid.is_frozen
    )


def info_data(info: VehicleInfo, table: DiagnosticTable, state: ServerState) -> bytes:
    """Return a piece of vehicle information, filled up with zeros."""
    data = info.fixed_bytes
    if info.data is not None:
        datum = table.data[info.data]
        data = state.written.get(info.data, datum.initial_bytes)
    return data[: info.size_bytes].ljust(info.size_bytes, b"\0")


def emission_data(table: DiagnosticTable, state: ServerState, moment: Instant, number: int) -> bytes | None:
    """Return what a data identifier of SAE J1979-2 holds; None if it is none, or OBD is not spoken in that way."""
    if table.obd is None or table.obd.profile is not Profile.UDS:
        return None
    place = number & 0xFF
    if number & 0xFF00 == PID_DATA:
        if place % BLOCK == 0:
            return supported(table.obd.pids, place)
        pid = table.obd.pids.get(place)
        return None if pid is None else pid_data(pid, table, state, moment)
    if number & 0xFF00 == INFO_DATA:
        if place % BLOCK == 0:
            return supported(table.obd.infos, place)
        info = table.obd.infos.get(place)
        return None if info is None else info_data(info, table, state)
    return None


def _encoded(pid: Pid, values: Values) -> bytes:
    return encode(pid.fields, values, keeps_code=False)


def _with_obd(table: DiagnosticTable, state: ServerState, moment: Instant) -> Values:
    confirmed = emission_codes(table.troubles, state.memory, Status.CONFIRMED)
    lamp = _LAMP if is_lamp_on(state.memory) else 0
    more: dict[str, Value] = {
        "obd.monitor_status": bytes([lamp | min(_MOST_CODES, len(confirmed)), _COMPONENTS, 0, 0]),
        "obd.monitor_status_this_cycle": bytes([0, _COMPONENTS, 0, 0]),
        "obd.warm_ups": state.emissions.warm_ups,
    }
    distance_m = odometer_m(moment)
    if distance_m is not None:
        more["obd.distance_since_clear_m"] = max(0.0, distance_m - (state.emissions.cleared_at_m or 0.0))
        lamp_at_m = distance_m if not lamp else state.emissions.lamp_at_m or 0.0
        more["obd.distance_with_lamp_m"] = max(0.0, distance_m - lamp_at_m)
    return {**moment.values, **more}
