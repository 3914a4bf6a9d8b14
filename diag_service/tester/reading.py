"""What a controller can be asked, as questions and records: trouble codes, data, routines."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from diag_service.errors import MalformedError, RefusedError
from diag_service.tester.answers import (
    BY_MASK,
    EXTENDED,
    READ_DATA,
    READ_TROUBLE,
    READINESS,
    ROUTINE,
    SNAPSHOTS,
    SUPPORTED,
    WITH_RECORD,
    refusal_text,
    shown,
)
from diag_service.tester.description import Description, Values, fields_size_bytes, read_fields
from diag_service.tester.trouble import TroubleCode, read_codes, read_extended, read_snapshots

if TYPE_CHECKING:
    from diag_service.tester.dialogue import Dialogue

ALL_RECORDS: Final = 0xFF
EMISSIONS: Final = 0x33  # functional group (ISO 14229-1, annex D)
FAILED_MASK: Final = 0xAF  # all bits but those that tell of a test that did not run
FAILED: Final = bytes([READ_TROUBLE, BY_MASK, FAILED_MASK])  # the question for them
START, STOP, RESULTS = 0x01, 0x02, 0x03
ACTIONS: Final = {"start": START, "stop": STOP, "results": RESULTS}


@dataclass(frozen=True, slots=True, kw_only=True)
class DataAnswer:
    """What a controller says of one datum: its bytes and what they mean, or why there are none."""

    number: int
    name: str
    data: bytes = b""
    values: Values | None = None
    refusal: int | None = None
    fault: str = ""  # what is wrong with its answer

    @property
    def refusal_text(self) -> str:
        """Why it will not tell, empty if it does."""
        return "" if self.refusal is None else refusal_text(self.refusal)

    @property
    def trouble(self) -> str:
        """Why there are no values, empty if there are."""
        return self.refusal_text or self.fault


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutineAnswer:
    """What a controller says of a routine."""

    number: int
    name: str
    action: str
    data: bytes
    values: Values


def trouble_request(mask: int, *, group: int | None = None, record: int | None = None) -> bytes:
    """Return the question for codes with a status bit of the mask; 0: for all that the controller knows.

    With a group or a record it is that for the codes of OBD of a readiness group, or for those with a record of
    extended data, whatever their status (SAE J1979-2).
    """
    if group is not None:
        return bytes([READ_TROUBLE, READINESS, EMISSIONS, group])
    if record is not None:
        return bytes([READ_TROUBLE, WITH_RECORD, record])
    return bytes([READ_TROUBLE, BY_MASK, mask]) if mask else bytes([READ_TROUBLE, SUPPORTED])


def read_troubles(
    tester: "Dialogue", description: Description, request: bytes = FAILED, *, has_details: bool = True
) -> tuple[TroubleCode, ...]:
    """Return the trouble codes for which a `trouble_request` asks.

    With details each comes with its snapshots and extended data, as far as the controller has them.
    """
    codes = read_codes(tester.ask(request), description)
    if not has_details:
        return codes
    record = request[2] if request[1] == WITH_RECORD else ALL_RECORDS
    return tuple(_with_details(tester, description, code, record) for code in codes)


def _with_details(tester: "Dialogue", description: Description, code: TroubleCode, record: int) -> TroubleCode:
    """Return a code with what was kept of it; a controller that keeps nothing, or will not tell, is no error."""
    number = code.number.to_bytes(3, "big")
    snapshots = tester.may_ask(bytes([READ_TROUBLE, SNAPSHOTS]) + number + bytes([ALL_RECORDS]))
    extended = tester.may_ask(bytes([READ_TROUBLE, EXTENDED]) + number + bytes([record]))
    return replace(
        code,
        snapshots=() if isinstance(snapshots, RefusedError) else read_snapshots(snapshots, description),
        extended=() if isinstance(extended, RefusedError) else read_extended(extended, description),
    )


def read_data(tester: "Dialogue", description: Description, numbers: Iterable[int]) -> list[DataAnswer]:
    """Return what a controller says of each datum; they are asked for one at a time, so one refusal costs one."""
    return [_read_datum(tester, description, number) for number in numbers]


def _read_datum(tester: "Dialogue", description: Description, number: int) -> DataAnswer:
    name = description.data_name(number)
    try:
        answer = tester.may_ask(bytes([READ_DATA]) + number.to_bytes(2, "big"))
    except MalformedError as exc:
        return DataAnswer(number=number, name=name, fault=str(exc))
    if isinstance(answer, RefusedError):
        return DataAnswer(number=number, name=name, refusal=answer.code)
    data = answer[3:]
    if (size := description.size_bytes(number)) not in {None, len(data)}:
        return DataAnswer(
            number=number, name=name, fault=f"its length in bytes is described as {size}, and it came as {shown(data)}"
        )
    return DataAnswer(number=number, name=name, data=data, values=description.values(number, data))


def control_routine(
    tester: "Dialogue", description: Description, number: int, action: str, options: bytes = b""
) -> RoutineAnswer:
    """Start or stop a routine, or ask for its results, and return what the controller answers.

    Raises
    ------
    RefusedError, SilentError, ControllerError
        As a `Dialogue` does.
    """
    request = bytes([ROUTINE, ACTIONS[action]]) + number.to_bytes(2, "big") + options
    data = tester.ask(request)[4:]
    routine = description.routines.get(number)
    fields = () if routine is None else routine.results
    if (size := fields_size_bytes(fields)) not in {None, len(data)}:
        if ACTIONS[action] == RESULTS:
            text = f"{tester.where}: the length in bytes of the results of routine {number:04X} is described as {size}"
            raise MalformedError(f"{text}, and they came as {shown(data) or 'nothing'}")
        fields = ()  # an answer to a start may hold the results, or something else
    name = "" if routine is None else routine.name
    return RoutineAnswer(number=number, name=name, action=action, data=data, values=read_fields(fields, data))
