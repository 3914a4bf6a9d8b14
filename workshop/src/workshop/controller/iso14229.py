"""Numbers of ISO 14229-1: services, negative response codes, bits of a trouble code's status."""

from enum import IntEnum, IntFlag
from typing import Final

POSITIVE: Final = 0x40  # added to a service's number in a positive response
NEGATIVE: Final = 0x7F  # begins a negative response
SUPPRESS: Final = 0x80  # suppressPosRspMsgIndicationBit of a sub-function
DEFAULT_SESSION: Final = 0x01
ALL_CODES: Final = 0xFFFFFF  # group of all trouble codes


class Service(IntEnum):
    """Services that this server knows, by their identifier."""

    SESSION_CONTROL = 0x10
    ECU_RESET = 0x11
    CLEAR_CODES = 0x14
    READ_CODES = 0x19
    READ_DATA = 0x22
    SECURITY_ACCESS = 0x27
    COMMUNICATION_CONTROL = 0x28
    DEFINE_DATA = 0x2C
    WRITE_DATA = 0x2E
    ROUTINE_CONTROL = 0x31
    TESTER_PRESENT = 0x3E
    CONTROL_CODE_SETTING = 0x85


class ObdService(IntEnum):
    """Services of SAE J1979 (ISO 15031-5)."""

    CURRENT_DATA = 0x01
    FREEZE_FRAME = 0x02
    CONFIRMED_CODES = 0x03
    CLEAR = 0x04
    TEST_RESULTS = 0x06
    PENDING_CODES = 0x07
    VEHICLE_INFORMATION = 0x09
    PERMANENT_CODES = 0x0A


class Nrc(IntEnum):
    """Negative response codes, annex A; those from 0x81 on name the violated condition."""

    SERVICE_NOT_SUPPORTED = 0x11
    SUB_FUNCTION_NOT_SUPPORTED = 0x12
    INCORRECT_LENGTH = 0x13
    RESPONSE_TOO_LONG = 0x14
    BUSY_REPEAT_REQUEST = 0x21
    CONDITIONS_NOT_CORRECT = 0x22
    REQUEST_SEQUENCE_ERROR = 0x24
    REQUEST_OUT_OF_RANGE = 0x31
    SECURITY_ACCESS_DENIED = 0x33
    INVALID_KEY = 0x35
    EXCEEDED_NUMBER_OF_ATTEMPTS = 0x36
    TIME_DELAY_NOT_EXPIRED = 0x37
    PROGRAMMING_FAILURE = 0x72
    RESPONSE_PENDING = 0x78
    SUB_FUNCTION_NOT_SUPPORTED_IN_SESSION = 0x7E
    SERVICE_NOT_SUPPORTED_IN_SESSION = 0x7F
    RPM_TOO_HIGH = 0x81
    RPM_TOO_LOW = 0x82
    ENGINE_IS_RUNNING = 0x83
    ENGINE_IS_NOT_RUNNING = 0x84
    ENGINE_RUN_TIME_TOO_LOW = 0x85
    TEMPERATURE_TOO_HIGH = 0x86
    TEMPERATURE_TOO_LOW = 0x87
    VEHICLE_SPEED_TOO_HIGH = 0x88
    VEHICLE_SPEED_TOO_LOW = 0x89
    PEDAL_TOO_HIGH = 0x8A
    PEDAL_TOO_LOW = 0x8B
    NOT_IN_NEUTRAL = 0x8C
    NOT_IN_GEAR = 0x8D
    BRAKE_NOT_CLOSED = 0x8F
    NOT_IN_PARK = 0x90
    CONVERTER_LOCKED = 0x91
    VOLTAGE_TOO_HIGH = 0x92
    VOLTAGE_TOO_LOW = 0x93


SILENT_WHEN_FUNCTIONAL: Final = frozenset(
    {
        Nrc.SERVICE_NOT_SUPPORTED,
        Nrc.SUB_FUNCTION_NOT_SUPPORTED,
        Nrc.REQUEST_OUT_OF_RANGE,
        Nrc.SUB_FUNCTION_NOT_SUPPORTED_IN_SESSION,
        Nrc.SERVICE_NOT_SUPPORTED_IN_SESSION,
    }
)
"""Negative responses that are not sent to functional requests."""


class DtcStatus(IntFlag):
    """Bits of a trouble code's status, annex D.2."""

    TEST_FAILED = 0x01
    FAILED_THIS_CYCLE = 0x02
    PENDING = 0x04
    CONFIRMED = 0x08
    NOT_TESTED_SINCE_CLEAR = 0x10
    FAILED_SINCE_CLEAR = 0x20
    NOT_TESTED_THIS_CYCLE = 0x40
    WARNING_REQUESTED = 0x80


CLEARED: Final = DtcStatus.NOT_TESTED_SINCE_CLEAR | DtcStatus.NOT_TESTED_THIS_CYCLE
ALL_BITS: Final = 0xFF  # status availability mask: all bits are supported
