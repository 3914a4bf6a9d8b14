"""Data by identifier: services 22 (read), 2C (define) and 2E (write)."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from workshop.controller.descriptions import (
    AccessRule,
    DataIdentifier,
    DatumField,
    Pid,
    Value,
    Values,
    VehicleInfo,
    are_valid,
    encode,
)
from workshop.controller.iso14229 import DtcStatus, Nrc
from workshop.controller.memory import FrozenPids, emission_codes, is_lamp_on, located
from workshop.controller.state import (
    Call,
    Instant,
    Piece,
    Result,
    ServerState,
    is_in_session,
    is_unlocked,
    unmet,
    unmet_by_service,
)
from workshop.controller.table import DiagnosticTable

STARTING: Final = "is_starting"  # value that is 1 until the first frame, as while kernels are compiled
DEFINE_BY_IDENTIFIER: Final = 0x01
CLEAR_DEFINITION: Final = 0x03
DEFINABLE_PAGE: Final = 0xF3  # annex C: upper byte of data that clients may define
_NAME_BYTES: Final = 2
_PIECE_BYTES: Final = 4


def data_of(datum: DataIdentifier, state: ServerState, moment: Instant) -> bytes:
    """Return the present bytes of a datum: written ones, or values of the vehicle."""
    if datum.initial is not None:
        return state.written.get(datum.number, datum.initial_bytes)
    return encode(datum.fields, {**moment.values, "active_session": state.session})


def read_data(call: Call) -> Result:
    """Read data; unknown identifiers are left out, and refused if all are unknown."""
    names = call.payload[1:]
    if not names or len(names) % _NAME_BYTES or len(names) > _NAME_BYTES * call.table.limits.most_data:
        return Nrc.INCORRECT_LENGTH
    response, is_any = b"", False
    for place in range(0, len(names), _NAME_BYTES):
        name = names[place : place + _NAME_BYTES]
        sources = readable(call.table, call.state, int.from_bytes(name, "big"))
        if not sources:
            continue
        is_any = True
        if refusal := read_refusal(call, sources):
            return refusal
        response += name + data_in(call.table, call.state, call.moment, sources)
    if not is_any:
        return Nrc.REQUEST_OUT_OF_RANGE
    if 1 + len(response) > call.table.limits.most_response_bytes:
        return Nrc.RESPONSE_TOO_LONG
    return call.positive(response)


def readable(table: DiagnosticTable, state: ServerState, number: int) -> tuple[Piece, ...]:
    """Return the pieces of a data identifier; empty if the session does not have it."""
    datum = table.data.get(number)
    if datum is None:
        pieces = state.defined.get(number, ())
    else:
        pieces = (Piece(source=number, start=0, size_bytes=datum.size_bytes),)
    return pieces if all(state.session in table.data[piece.source].read.sessions for piece in pieces) else ()


def read_refusal(call: Call, pieces: Iterable[Piece]) -> Nrc | None:
    """Return why pieces of data cannot be read now: security, missing values, or a condition."""
    for datum in (call.table.data[piece.source] for piece in pieces):
        if not is_unlocked(call.state, datum.read.levels):
            return Nrc.SECURITY_ACCESS_DENIED
        if datum.initial is None and _are_awaited(datum.fields, call):
            return Nrc.BUSY_REPEAT_REQUEST
        if refusal := unmet(call, datum.read.conditions):
            return refusal
    return None


def _are_awaited(fields: Iterable[DatumField], call: Call) -> bool:
    """Return whether a value is missing because the vehicle has sent no frame yet."""
    known = {*_with_obd(call.table, call.state, call.moment), "active_session"}
    return bool(call.moment.values.get(STARTING)) and any(entry.source not in known for entry in fields)


def is_pid_awaited(call: Call, number: int) -> bool:
    """Return whether a PID has no value because the vehicle has sent no frame yet."""
    pid = None if call.table.obd is None else call.table.obd.pids.get(number)
    return pid is not None and not pid.initial and _are_awaited(pid.fields, call)


def data_in(table: DiagnosticTable, state: ServerState, moment: Instant, pieces: Iterable[Piece]) -> bytes:
    return b"".join(
        data_of(table.data[piece.source], state, moment)[piece.start : piece.start + piece.size_bytes]
        for piece in pieces
    )


def _is_definable(number: int) -> bool:
    return number >> 8 == DEFINABLE_PAGE


def write_data(call: Call) -> Result:
    """Write a stored datum; it survives a restart."""
    if len(call.payload) < 1 + _NAME_BYTES + 1:
        return Nrc.INCORRECT_LENGTH
    datum, data = call.table.data.get(int.from_bytes(call.payload[1:3], "big")), call.payload[3:]
    if datum is None or datum.write is None or not is_in_session(call, datum.write):
        return Nrc.REQUEST_OUT_OF_RANGE
    if refusal := _write_refusal(call, datum, datum.write, data):
        return refusal
    state = replace(call.state, written={**call.state.written, datum.number: data})
    return call.positive(call.payload[1:3], state)


def _write_refusal(call: Call, datum: DataIdentifier, access: AccessRule, data: bytes) -> Nrc | None:
    if len(data) != datum.size_bytes:
        return Nrc.INCORRECT_LENGTH
    if not is_unlocked(call.state, access.levels):
        return Nrc.SECURITY_ACCESS_DENIED
    if not are_valid(datum.fields, data):
        return Nrc.REQUEST_OUT_OF_RANGE
    return unmet_by_service(call) or unmet(call, access.conditions)


def define_data(call: Call) -> Result:
    """Define a datum from pieces of others, or delete a definition."""
    if call.sub_function == CLEAR_DEFINITION:
        return _forgotten(call)
    described = call.payload[2 + _NAME_BYTES :]
    if not described or len(described) % _PIECE_BYTES:
        return Nrc.INCORRECT_LENGTH
    number = int.from_bytes(call.payload[2:4], "big")
    if not _is_definable(number):
        return Nrc.REQUEST_OUT_OF_RANGE
    pieces = [
        Piece(
            source=int.from_bytes(described[place : place + 2], "big"),
            start=described[place + 2] - 1,
            size_bytes=described[place + 3],
        )
        for place in range(0, len(described), _PIECE_BYTES)
    ]
    count = len(pieces) + sum(map(len, call.state.defined.values()))
    if not all(_is_within(call, piece) for piece in pieces) or count > call.table.limits.most_pieces:
        return Nrc.REQUEST_OUT_OF_RANGE
    if refusal := read_refusal(call, pieces):
        return refusal
    before = call.state.defined.get(number, ())
    state = replace(call.state, defined={**call.state.defined, number: (*before, *pieces)})
    return call.echoed(call.payload[2:4], state)


def _is_within(call: Call, piece: Piece) -> bool:
    datum = call.table.data.get(piece.source)
    if datum is None or not is_in_session(call, datum.read):
        return False
    return piece.start >= 0 and piece.size_bytes > 0 and piece.start + piece.size_bytes <= datum.size_bytes


def _forgotten(call: Call) -> Result:
    name = call.payload[2:]
    if len(name) not in {0, _NAME_BYTES}:
        return Nrc.INCORRECT_LENGTH
    number = int.from_bytes(name, "big")
    if name and not _is_definable(number):
        return Nrc.REQUEST_OUT_OF_RANGE
    left = {known: pieces for known, pieces in call.state.defined.items() if name and known != number}
    return call.echoed(name, replace(call.state, defined=left))


_LAMP: Final = 0x80
_MOST_CODES: Final = 0x7F
_COMPONENTS: Final = 0x04  # comprehensive components: monitored continuously, always ready


def odometer_m(moment: Instant) -> float | None:
    """Return the odometer [m], None if it is unknown."""
    distance_m = moment.values.get("odometer_m")
    return distance_m if isinstance(distance_m, int | float) else None


def pid_data(pid: Pid, table: DiagnosticTable, state: ServerState, moment: Instant) -> bytes:
    """Return the present bytes of a PID."""
    return pid.initial_bytes or encode(pid.fields, _with_obd(table, state, moment), keeps_code=False)


def frozen_pids(table: DiagnosticTable, state: ServerState, moment: Instant) -> FrozenPids:
    """Return the PIDs of a freeze frame with their bytes."""
    if table.obd is None:
        return ()
    frozen = (pid for pid in table.obd.pids.values() if pid.is_frozen)
    return tuple((pid.number, pid_data(pid, table, state, moment)) for pid in frozen)


def info_data(info: VehicleInfo, table: DiagnosticTable, state: ServerState) -> bytes:
    """Return a piece of vehicle information, padded with zeros."""
    data = info.fixed_bytes
    if info.data is not None:
        datum = table.data[info.data]
        data = state.written.get(info.data, datum.initial_bytes)
    return data[: info.size_bytes].ljust(info.size_bytes, b"\0")


def _with_obd(table: DiagnosticTable, state: ServerState, moment: Instant) -> Values:
    confirmed = emission_codes(table.troubles, state.memory, DtcStatus.CONFIRMED)
    lamp = _LAMP if is_lamp_on(state.memory) else 0
    more: dict[str, Value] = {
        "obd.monitor_status": bytes([lamp | min(_MOST_CODES, len(confirmed)), _COMPONENTS, 0, 0]),
        "obd.monitor_status_this_cycle": bytes([0, _COMPONENTS, 0, 0]),
        "obd.warm_ups": state.emissions.warm_ups,
    }
    distance_m = odometer_m(moment)
    if distance_m is not None:
        known = located(state.emissions, state.memory, distance_m)
        more["obd.distance_since_clear_m"] = max(0.0, distance_m - (known.cleared_at_m or 0.0))
        more["obd.distance_with_lamp_m"] = 0.0 if known.lamp_at_m is None else max(0.0, distance_m - known.lamp_at_m)
    return {**moment.values, **more}
