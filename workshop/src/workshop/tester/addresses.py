"""CAN identifiers of requests and answers (ISO 15765-4, ISO 15765-2)."""

import re
from dataclasses import dataclass
from typing import Final

from diag_service.errors import ConfigError

LARGEST_STANDARD_ID: Final = 0x7FF
LARGEST_ID: Final = 0x1FFF_FFFF
STANDARD_REQUESTS: Final = range(0x7E0, 0x7E8)  # ISO 15765-4: of the eight controllers of OBD
RESPONSE_OFFSET: Final = 8
FUNCTIONAL_ID: Final = 0x7DF
FIXED_PHYSICAL: Final = 0x18DA_0000  # ISO 15765-2, normal fixed addressing: target and source in the lower bytes
FIXED_FUNCTIONAL: Final = 0x18DB_33F1
TESTER_ADDRESS: Final = 0xF1
TRANSMISSION: Final = 0x7E1  # ISO 15765-4: the second controller
GROUP_REQUEST: Final = 0xEA  # SAE J1939-21: PDU format of a request for a parameter group (PGN 59904)
TOOLS: Final = (0xF9, 0xFA)  # SAE J1939-81: addresses of off-board diagnostic tools; ours is the first
TO_ALL: Final = 0xFF
_HEXADECIMAL: Final = re.compile(r"(?:0x)?[0-9a-f]{1,8}", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class CanAddress:
    """Identifiers of the requests to and the answers of one controller.

    With ``target_byte`` it has extended addressing: the first byte of requests is ``target_byte``, that of answers
    ``tester_byte``.
    """

    request_id: int
    response_id: int
    target_byte: int | None = None
    tester_byte: int = TESTER_ADDRESS

    def __post_init__(self) -> None:
        for name, can_id in (("request", self.request_id), ("response", self.response_id)):
            if not 0 <= can_id <= LARGEST_ID:
                raise ConfigError(f"the identifier of the {name} must be 0..{LARGEST_ID:X}, got {can_id:X}")
        if self.request_id == self.response_id:
            raise ConfigError(f"request and response cannot have the same identifier {self.request_id:X}")
        if is_extended(self.request_id) != is_extended(self.response_id):
            raise ConfigError("request and response must both have 11 bits or both 29")

    def __str__(self) -> str:
        more = "" if self.target_byte is None else f", address {self.target_byte:02X}"
        return f"{id_text(self.request_id)} (answers {id_text(self.response_id)}{more})"


def is_extended(can_id: int) -> bool:
    """Return whether an identifier has 29 bits."""
    return can_id > LARGEST_STANDARD_ID


def id_text(can_id: int) -> str:
    """Return an identifier in hexadecimal, with three digits or eight."""
    return f"{can_id:08X}" if is_extended(can_id) else f"{can_id:03X}"


def hexadecimal(text: str, what: str, most: int) -> int:
    """Return a number from hexadecimal text, with or without 0x.

    Raises ConfigError if it is invalid, or more than ``most``.
    """
    if not _HEXADECIMAL.fullmatch(text) or int(text, 16) > most:
        raise ConfigError(f"{what} must be hexadecimal, 0 to {most:X}, got {text!r}")
    return int(text, 16)


def number_of(text: str | None, what: str, most: int) -> int | None:
    """Return a number from hexadecimal text, None without text; raises ConfigError as ``hexadecimal``."""
    return None if text is None else hexadecimal(text, what, most)


def check_number(name: str, value: int, most: int) -> None:
    """Raise ConfigError unless a number is 0 to ``most``."""
    if not 0 <= value <= most:
        raise ConfigError(f"{name} must be 0 to {most:X} in hexadecimal, got {value:X}")


def usual_response_id(request_id: int) -> int:
    """Return the usual identifier of the answers to a request.

    With 29 bits and normal fixed addressing target and source are swapped; with 11 bits the answer is 8 above. Raises
    ConfigError if there is no rule for this identifier.
    """
    if is_extended(request_id):
        if request_id >> 16 != FIXED_PHYSICAL >> 16:
            raise ConfigError(f"--reply is needed: how {id_text(request_id)} is answered cannot be derived from it")
        target, source = request_id >> 8 & 0xFF, request_id & 0xFF
        return FIXED_PHYSICAL | source << 8 | target
    if request_id == FUNCTIONAL_ID:
        raise ConfigError(f"--reply is needed: {id_text(request_id)} asks all controllers; rather ask one, such as 7E1")
    if request_id + RESPONSE_OFFSET > LARGEST_STANDARD_ID:
        raise ConfigError(f"--reply is needed: {id_text(request_id)} and 8 are more than 7FF")
    return request_id + RESPONSE_OFFSET


def parse_address(request: str | None, response: str | None, target: str | None = None) -> CanAddress | None:
    """Return the address by options of a command line; None without them.

    Raises ConfigError if one is invalid, or they contradict each other.
    """
    return can_address(
        number_of(request, "--ecu", LARGEST_ID),
        number_of(response, "--reply", LARGEST_ID),
        number_of(target, "--address", 0xFF),
    )


def can_address(request_id: int | None, response_id: int | None, target_byte: int | None = None) -> CanAddress | None:
    """Return the address of a controller, None without an identifier; raises ConfigError."""
    if request_id is None:
        if response_id is not None or target_byte is not None:
            raise ConfigError("--reply and --address need --ecu")
        return None
    if target_byte is not None:
        check_number("address", target_byte, 0xFF)
    response_id = usual_response_id(request_id) if response_id is None else response_id
    return CanAddress(request_id=request_id, response_id=response_id, target_byte=target_byte)


def is_request(can_id: int) -> bool:
    """Return whether an identifier is a request of testers by the standard."""
    if not is_extended(can_id):
        return can_id == FUNCTIONAL_ID or can_id in STANDARD_REQUESTS
    if can_id >> 16 & 0xFF == GROUP_REQUEST:
        return can_id & 0xFF in TOOLS  # controllers also send such requests
    return can_id >> 16 in {FIXED_PHYSICAL >> 16, FIXED_FUNCTIONAL >> 16} and can_id & 0xFF == TESTER_ADDRESS
