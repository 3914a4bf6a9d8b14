"""OBD as SAE J1979 (ISO 15031-5) has it on CAN: services 01 to 0A.

A functional request for something unknown gets no response, a physical one is refused (12).
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Final, TypeVar

from workshop.controller.descriptions import BLOCK, MonitorTest, Obd, VehicleInfo, supported
from workshop.controller.iso14229 import ALL_CODES, DtcStatus, Nrc, ObdService
from workshop.controller.memory import FAILED_COUNTER, PASSED_COUNTER, TroubleRecord, emission_codes
from workshop.controller.services.data import info_data, is_pid_awaited, pid_data
from workshop.controller.services.trouble import cleared
from workshop.controller.state import Call, Result, unmet

MOST_PIDS: Final = 6  # in one request
MOST_FROZEN_PIDS: Final = 3
FRAME: Final = 0x00  # the only freeze frame
CODE_OF_FRAME: Final = 0x02  # parameter of the freeze frame: the code that it belongs to
NOT_THERE: Final = Nrc.SUB_FUNCTION_NOT_SUPPORTED
COUNTER_TEST: Final = 0x80  # the first test number that a maker may define
SIGNED_COUNT: Final = 0x81  # unit and scaling: a signed number without unit
_CODE_BYTES: Final = 2
_MOST_CODES: Final = 0xFF
ONE_ITEM: Final = 0x01

EntryT = TypeVar("EntryT")


def current_data(call: Call) -> Result:
    """Read up to six PIDs or bitmaps of supported PIDs."""
    obd, numbers = _obd(call), call.payload[1:]
    if not 1 <= len(numbers) <= MOST_PIDS:
        return NOT_THERE
    if any(is_pid_awaited(call, number) for number in numbers):
        return Nrc.BUSY_REPEAT_REQUEST
    return _found(call, (_pid(call, obd, number) for number in numbers))


def _pid(call: Call, obd: Obd, number: int) -> bytes:
    """Return the number and bytes of a PID, empty if it is not supported."""
    pid = obd.pids.get(number)
    if pid is None:
        return _bitmap(obd.pids, number)
    return bytes([number]) + pid_data(pid, call.table, call.state, call.moment)


def freeze_frame(call: Call) -> Result:
    """Read up to three PIDs of the freeze frame; without a frame, PID 02 says that there is no code."""
    pairs = call.payload[1:]
    if not pairs or len(pairs) % 2 or len(pairs) > 2 * MOST_FROZEN_PIDS:
        return NOT_THERE
    wanted = ((pairs[place], pairs[place + 1]) for place in range(0, len(pairs), 2))
    return _found(call, (_frozen_pid(call, number) for number, frame in wanted if frame == FRAME))


def _frozen_pid(call: Call, number: int) -> bytes:
    frame = call.state.emissions.frame
    frozen = {} if frame is None else dict(frame.pids)
    if number % BLOCK == 0:
        there = {number: b"" for number, pid in _obd(call).pids.items() if pid.is_frozen}
        data = supported({CODE_OF_FRAME: b"", **there}, number)
    elif number == CODE_OF_FRAME:
        data = bytes(_CODE_BYTES) if frame is None else _short_code(frame.code)
    else:
        data = frozen.get(number)
    return b"" if data is None else bytes([number, FRAME]) + data


def _codes_with(bits: DtcStatus, call: Call) -> Result:
    """Read the codes of OBD whose status has one of these bits."""
    return _codes(call, emission_codes(call.table.troubles, call.state.memory, bits))


def _codes(call: Call, numbers: Iterable[int]) -> Result:
    if len(call.payload) != 1:
        return NOT_THERE
    codes = list(dict.fromkeys(_short_code(number) for number in numbers))[:_MOST_CODES]  # two failure types are one
    return call.positive(bytes([len(codes)]) + b"".join(codes))


def _short_code(number: int) -> bytes:
    """Return a code without its failure type."""
    return (number >> 8).to_bytes(_CODE_BYTES, "big")


def clear_emission_codes(call: Call) -> Result:
    """Clear all codes, as service 14 does; a violated condition is refused with 22."""
    if len(call.payload) != 1:
        return NOT_THERE
    if unmet(call, _obd(call).clear_conditions):
        return Nrc.CONDITIONS_NOT_CORRECT
    return call.positive(state=cleared(call, ALL_CODES))


def vehicle_information(call: Call) -> Result:
    """Read one piece of vehicle information, or bitmaps of the supported ones."""

    def read(info: VehicleInfo) -> bytes:
        return bytes([info.number, ONE_ITEM]) + info_data(info, call.table, call.state)

    return _one_or_bitmaps(call, _obd(call).infos, read)


def test_results(call: Call) -> Result:
    """Read the result of one monitor, or bitmaps of the supported monitors.

    The result is the fault detection counter of the monitor's trouble code, and zero before its first test.
    """

    def read(monitor: MonitorTest) -> bytes:
        numbers = (number for number, trouble in call.table.troubles.items() if trouble.code == monitor.code)
        records = (call.state.memory.records[number] for number in numbers)
        return b"".join(bytes([monitor.number]) + _test_result(record) for record in records)

    return _one_or_bitmaps(call, _obd(call).monitors, read)


def _test_result(record: TroubleRecord) -> bytes:
    """Return test number, unit, result, lower and upper limit."""
    has_run = not record.status & DtcStatus.NOT_TESTED_SINCE_CLEAR
    numbers = (record.detection_counter, PASSED_COUNTER, FAILED_COUNTER - 1) if has_run else (0, 0, 0)
    return bytes([COUNTER_TEST, SIGNED_COUNT]) + b"".join(number.to_bytes(2, "big", signed=True) for number in numbers)


def _one_or_bitmaps(call: Call, known: Mapping[int, EntryT], read: Callable[[EntryT], bytes]) -> Result:
    """Read one entry of a service, or up to six bitmaps of the supported entries."""
    numbers = call.payload[1:]
    if not 1 <= len(numbers) <= MOST_PIDS:
        return NOT_THERE
    if all(number % BLOCK == 0 for number in numbers):
        return _found(call, (_bitmap(known, number) for number in numbers))
    entry = known.get(numbers[0])
    return NOT_THERE if entry is None or len(numbers) != 1 else call.positive(read(entry))


def _bitmap(known: Mapping[int, object], number: int) -> bytes:
    """Return a bitmap behind its number, empty if the number has none."""
    bitmap = supported(known, number)
    return b"" if bitmap is None else bytes([number]) + bitmap


def _found(call: Call, pieces: Iterable[bytes]) -> Result:
    """Return the joined pieces as a response; a refusal if there are none."""
    data = b"".join(pieces)
    return call.positive(data) if data else NOT_THERE


def _obd(call: Call) -> Obd:
    if call.table.obd is None:
        raise ValueError("these services are not called without OBD")
    return call.table.obd


OBD_HANDLERS: Final[Mapping[int, Callable[[Call], Result]]] = {
    ObdService.CURRENT_DATA: current_data,
    ObdService.FREEZE_FRAME: freeze_frame,
    ObdService.CONFIRMED_CODES: partial(_codes_with, DtcStatus.CONFIRMED),
    ObdService.CLEAR: clear_emission_codes,
    ObdService.TEST_RESULTS: test_results,
    # failed in this operation cycle or in the last completed one
    ObdService.PENDING_CODES: partial(_codes_with, DtcStatus.PENDING),
    ObdService.VEHICLE_INFORMATION: vehicle_information,
    # cannot be cleared by a client
    ObdService.PERMANENT_CODES: lambda call: _codes(call, sorted(call.state.emissions.permanent)),
}
