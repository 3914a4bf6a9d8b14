"""Descriptions of controllers for the tester: data, codes, routines; from TOML or ODX (ISO 22901-1)."""

import math
import re
import struct
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, TypeVar

from canlog.extras import load_extra
from clutch_model.tables import read_table, record_from
from clutchdiag_io.files import check_plain_file
from diag_service.errors import ConfigError
from workshop.tester.addresses import LARGEST_ID
from workshop.tester.answers import POSITIVE, READ_DATA, ROUTINE

Value = float | str | None  # None: the controller says that it is not available
Values = Mapping[str, Value]
Reader = Callable[[bytes], Values]

SYSTEMS: Final = "PCBU"  # powertrain, chassis, body, network: the two upper bits of a code
_CODE: Final = re.compile(r"[PCBU][0-3][0-9A-F]{3}")
_LARGEST_DATA: Final = 0xFFFF
_FLOATS: Final = {4: ">f", 8: ">d"}
_DIGITS: Final = 12  # significant digits of a scaled number


class CodedType(StrEnum):
    """Coding of a value, big-endian."""

    UNSIGNED = "unsigned"
    SIGNED = "signed"
    FLOAT = "float"  # IEEE 754; not a number: not available
    TEXT = "text"
    BYTES = "bytes"


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One value within bytes."""

    name: str
    kind: CodedType
    size_bytes: int = 0  # 0: all remaining bytes, for the last field
    unit: str = ""
    resolution: float = 1.0  # of one bit, in that unit
    offset: float = 0.0
    invalid: int | None = None  # raw number that means "not available"
    meanings: Mapping[str, str] = field(default_factory=dict)  # by raw number

    def __post_init__(self) -> None:
        if self.size_bytes < 0 or (
            self.kind in {CodedType.UNSIGNED, CodedType.SIGNED} and not 1 <= self.size_bytes <= 8
        ):
            raise ConfigError(f"{self.name}: size_bytes {self.size_bytes} is not usable: a number has 1 to 8")
        if self.kind is CodedType.FLOAT and self.size_bytes not in _FLOATS:
            raise ConfigError(f"{self.name}: size_bytes {self.size_bytes} is not usable: a float has 4 or 8")
        if not (math.isfinite(self.resolution) and math.isfinite(self.offset)) or not self.resolution:
            raise ConfigError(f"{self.name}: resolution {self.resolution} and offset {self.offset} are not usable")
        try:
            _ = self.numbered_meanings
        except ValueError as exc:
            raise ConfigError(f"{self.name}: meanings are of whole numbers, got {sorted(self.meanings)}") from exc

    @property
    def label(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def numbered_meanings(self) -> dict[int, str]:
        return {int(number, 0): text for number, text in self.meanings.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Datum:
    """A data identifier, or a record of extended data."""

    number: int
    name: str
    fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        if not 0 <= self.number <= _LARGEST_DATA:
            raise ConfigError(f"{self.name}: its number must be 0..0xFFFF, got {self.number}")
        if not self.fields or any(not entry.size_bytes for entry in self.fields[:-1]):
            raise ConfigError(f"{self.name}: it needs fields, all but the last of them with size_bytes")

    @property
    def size_bytes(self) -> int | None:
        """Its length [byte]; None if it is unknown."""
        return fields_size_bytes(self.fields)


@dataclass(frozen=True, slots=True, kw_only=True)
class CodeDescription:
    """A trouble code and its text."""

    code: str  # P0811
    text: str
    failure_type: int | None = None  # None: any

    def __post_init__(self) -> None:
        if not _CODE.fullmatch(self.code):
            raise ConfigError(f"trouble code {self.code} is none: in capitals, as P0741, its failure_type apart")


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutineDescription:
    """A routine with its options and results."""

    number: int
    name: str
    options: tuple[Field, ...] = ()
    results: tuple[Field, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """A controller for the tester; data from ODX are decoded by readers in place of fields."""

    name: str
    data: Mapping[int, Datum] = field(default_factory=dict)
    extended: Mapping[int, Datum] = field(default_factory=dict)
    troubles: tuple[CodeDescription, ...] = ()
    routines: Mapping[int, RoutineDescription] = field(default_factory=dict)
    request_id: int | None = None
    response_id: int | None = None
    readers: Mapping[int, Reader] = field(default_factory=dict)

    def size_bytes(self, number: int) -> int | None:
        """Return the length of a datum [byte]; None if it is unknown."""
        datum = self.data.get(number)
        return None if datum is None else datum.size_bytes

    def data_name(self, number: int) -> str:
        """Return the name of a datum, empty if it is unknown."""
        datum = self.data.get(number) or STANDARD_DATA.get(number)
        return "" if datum is None else datum.name

    def values(self, number: int, data: bytes) -> Values:
        """Return the values in the bytes of a datum; an unknown datum as text or in hexadecimal."""
        if number in self.readers:
            return {name: _finite(value) for name, value in self.readers[number](data).items()}
        datum = self.data.get(number) or STANDARD_DATA.get(number)
        return {"": readable(data)} if datum is None else read_fields(datum.fields, data)

    def find_data(self, word: str) -> int:
        """Return the number of a datum by its name or in hexadecimal; raises ConfigError if it is neither."""
        return _find(word, {number: datum.name for number, datum in self.data.items()}, "datum")

    def find_routine(self, word: str) -> int:
        """Return the number of a routine by its name or in hexadecimal; raises ConfigError if it is neither."""
        return _find(word, {number: routine.name for number, routine in self.routines.items()}, "routine")

    def trouble_text(self, number: int) -> str:
        """Return the text of a code of three bytes, empty if unknown; one with its failure type has priority."""
        code, failure_type = code_text(number), number & 0xFF
        fitting = [
            trouble
            for trouble in self.troubles
            if trouble.code == code and trouble.failure_type in {None, failure_type}
        ]
        return max(fitting, key=lambda trouble: trouble.failure_type is not None).text if fitting else ""


def fields_size_bytes(fields: tuple[Field, ...]) -> int | None:
    """Return the length of fields [byte]; None if it is unknown."""
    return sum(entry.size_bytes for entry in fields) if fields and fields[-1].size_bytes else None


def code_text(number: int) -> str:
    """Return the two upper of three bytes as scan tools show them: P0897."""
    upper = number >> 8 & 0xFFFF
    return f"{SYSTEMS[upper >> 14]}{upper & 0x3FFF:04X}"


def read_fields(fields: tuple[Field, ...], data: bytes) -> dict[str, Value]:
    """Return the values in bytes by name and unit; missing fields are left out, surplus bytes are in hexadecimal."""
    values: dict[str, Value] = {}
    place = 0
    for entry in fields:
        piece = data[place : place + entry.size_bytes] if entry.size_bytes else data[place:]
        if len(piece) < entry.size_bytes:
            break
        place += len(piece)
        values[entry.label] = _finite(_value(entry, piece))
    if place < len(data):
        values["more bytes"] = data[place:].hex(" ").upper()
    return values


def _value(entry: Field, piece: bytes) -> Value:
    match entry.kind:
        case CodedType.TEXT:
            return readable(piece)
        case CodedType.BYTES:
            return piece.hex(" ").upper()
        case CodedType.FLOAT:
            return float(struct.unpack(_FLOATS[entry.size_bytes], piece)[0]) * entry.resolution + entry.offset
    number = int.from_bytes(piece, "big", signed=entry.kind is CodedType.SIGNED)
    if number == entry.invalid:
        return None
    is_scaled = entry.resolution != 1.0 or entry.offset
    value = float(f"{number * entry.resolution + entry.offset:.{_DIGITS}g}") if is_scaled else number
    return entry.numbered_meanings.get(number, value)


def _finite(value: Value) -> Value:
    """Return a value; NaN and infinity become None, not available."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def readable(data: bytes) -> str:
    """Return bytes as text without padding; in hexadecimal if they are not ASCII."""
    text = data.rstrip(b"\0 ")
    return text.decode("ascii") if all(0x20 <= byte < 0x7F for byte in text) else data.hex(" ").upper()


def _find(word: str, names: Mapping[int, str], what: str) -> int:
    numbers = [number for number, name in names.items() if name.casefold() == word.casefold()]
    if numbers:
        return numbers[0]
    if re.fullmatch(r"(?:0x)?[0-9A-F]{1,4}", word, re.IGNORECASE):
        return int(word, 16)
    known = "; it has " + ", ".join(sorted(names.values())) if names else ""
    raise ConfigError(f"{word!r} is not a {what}: give its number in hexadecimal or its name{known}")


PDX_SUFFIXES: Final = frozenset({".pdx", ".odx-d", ".odx"})
FOLDER: Final = Path(__file__).parent / "controllers"
MOST_BYTES: Final = 256 * 2**20
_START: Final = 0x01
_HEAD_BYTES: Final = 3  # of a response to service 22: the service and the number of the datum


_NumberedT = TypeVar("_NumberedT", Datum, RoutineDescription)


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """The datum and text by which a controller is recognised."""

    number: int
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DescriptionFile:
    """The content of a TOML file."""

    name: str
    request_id: int | None = None
    response_id: int | None = None
    identity: Identity | None = None
    data: tuple[Datum, ...] = ()
    extended: tuple[Datum, ...] = ()
    trouble: tuple[CodeDescription, ...] = ()
    routine: tuple[RoutineDescription, ...] = ()

    def __post_init__(self) -> None:
        for can_id in (self.request_id, self.response_id):
            if can_id is not None and not 0 <= can_id <= LARGEST_ID:
                raise ConfigError(f"request_id and response_id must be 0..0x{LARGEST_ID:X}, got {can_id}")

    @property
    def description(self) -> Description:
        """The description, with the standard data of all controllers."""
        return Description(
            name=self.name,
            data={**STANDARD_DATA, **_numbered(self.data, "data")},
            extended=_numbered(self.extended, "extended"),
            troubles=self.trouble,
            routines=_numbered(self.routine, "routine"),
            request_id=self.request_id,
            response_id=self.response_id,
        )


def find_description(name: Path | None) -> Description:
    """Return a description by its path or the name of a shipped one; without a name that of the standard data.

    Raises ConfigError if it does not exist or is invalid, ExtraMissingError if a PDX needs odxtools.
    """
    if name is None:
        return UNKNOWN
    if name.suffix.lower() in PDX_SUFFIXES:
        return load_odx(name)
    if len(name.parts) == 1 and not name.suffix and not name.exists():
        if name.name not in shipped_names():
            raise ConfigError(f"no controller {name}: give a .toml or .pdx file or one of {', '.join(shipped_names())}")
        return load_file(FOLDER / f"{name}.toml").description
    return load_file(name).description


def shipped_names() -> tuple[str, ...]:
    """Return the names of the descriptions that ship with the service."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def shipped() -> list[DescriptionFile]:
    return [load_file(FOLDER / f"{name}.toml") for name in shipped_names()]


def load_file(path: Path) -> DescriptionFile:
    """Return the content of a TOML file; raises ConfigError naming the first wrong key."""
    table = read_table(path, "the description", ConfigError)
    try:
        described = record_from(DescriptionFile, table, error=ConfigError)
        _ = described.description
    except ConfigError as exc:
        raise ConfigError(f"description {path}: {exc}") from exc
    return described


def _numbered(records: Iterable[_NumberedT], what: str) -> Mapping[int, _NumberedT]:
    numbered: dict[int, _NumberedT] = {}
    for record in records:
        if record.number in numbered:
            raise ConfigError(f"{what} 0x{record.number:04X} is there twice")
        numbered[record.number] = record
    return numbered


def load_odx(path: Path) -> Description:
    """Return the description of the first controller or base variant in a PDX package or an ODX file.

    Raises ConfigError if the file is invalid or has no controller, ExtraMissingError if odxtools is missing.
    """
    extra = "odx" if find_spec("udsoncan") else "odx,uds"
    odxtools = load_extra("odxtools", "PDX files need odxtools", extra, "./workshop")
    try:
        check_plain_file(path, MOST_BYTES)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of deviations from the standard
            database = odxtools.load_file(str(path), use_weakrefs=False)
    except OSError as exc:
        raise ConfigError(f"cannot read {path}: {exc.strerror or exc}") from exc
    except Exception as exc:
        raise ConfigError(f"{path} is not ODX that can be used: {' '.join(str(exc).split())}") from exc
    layers = [*database.ecu_variants, *database.base_variants]
    if not layers:
        raise ConfigError(f"{path} describes no controller")
    return _description(layers[0])


def _description(layer: Any) -> Description:  # noqa: ANN401 - of a library without a common type for layers
    data, readers = dict[int, Datum](), dict[int, Reader]()
    routines = dict[int, RoutineDescription]()
    for service, request in _constant_requests(layer):
        number = int.from_bytes(request[-2:], "big")
        if request[0] == READ_DATA and len(request) == _HEAD_BYTES:
            responses = service.positive_responses
            bits = responses[0].get_static_bit_length() if responses else None  # None: of variable length
            size_bytes = 0 if bits is None else max(0, bits // 8 - _HEAD_BYTES)
            whole = Field(name="bytes", kind=CodedType.BYTES, size_bytes=size_bytes)
            data[number] = Datum(number=number, name=_name(service), fields=(whole,))
            readers[number] = _reader(service, number)
        elif request[:2] == bytes([ROUTINE, _START]) and len(request) == 1 + _HEAD_BYTES:
            routines[number] = RoutineDescription(number=number, name=_name(service))
    return Description(
        name=layer.short_name,
        data={**STANDARD_DATA, **data},
        troubles=tuple(_troubles(layer)),
        routines=routines,
        request_id=_can_id(layer.get_can_receive_id, layer),
        response_id=_can_id(layer.get_can_send_id, layer),
        readers=readers,
    )


def _constant_requests(layer: Any) -> Iterator[tuple[Any, bytes]]:  # noqa: ANN401 - see above
    """Yield services and the constant beginning of their request."""
    for service in layer.services:
        if getattr(service, "request", None) is not None:
            prefix = bytes(service.request.coded_const_prefix())
            if len(prefix) >= _HEAD_BYTES:
                yield service, prefix


def _reader(service: Any, number: int) -> Reader:  # noqa: ANN401 - see above
    head = bytes([READ_DATA + POSITIVE]) + number.to_bytes(2, "big")

    def read(data: bytes) -> Values:
        try:
            decoded = service.decode_message(head + data).param_dict
        except Exception:  # noqa: BLE001 - whatever the library makes of bytes that do not fit the file
            return {"": data.hex(" ").upper()}
        fixed = {part.short_name for part in service.positive_responses[0].parameters if part.parameter_type != "VALUE"}
        values = list(_flat({name: value for name, value in decoded.items() if name not in fixed}))
        inner = Counter(path[-1] for path, _ in values)
        return {path[-1] if inner[path[-1]] == 1 else " ".join(path): value for path, value in values}

    return read


def _flat(value: object, path: tuple[str, ...] = ("",)) -> Iterator[tuple[tuple[str, ...], Value]]:
    """Yield nested values, each with its path of names."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(inner, (*filter(None, path), str(key)))
    elif isinstance(value, list | tuple):
        for place, inner in enumerate(value, 1):
            yield from _flat(inner, (*path[:-1], f"{path[-1]} {place}"))
    elif isinstance(value, bytes | bytearray):
        yield path, value.hex(" ").upper()
    elif isinstance(value, int | float | str):
        yield path, value
    else:
        yield path, None if value is None else str(value)


def _troubles(layer: Any) -> Iterator[CodeDescription]:  # noqa: ANN401 - see above
    dictionary = layer.diag_data_dictionary_spec
    listed = set[int]()
    for dop in () if dictionary is None else dictionary.dtc_dops:
        for dtc in dop.dtcs:
            number = int(dtc.trouble_code)
            if number in listed:
                continue
            listed.add(number)
            text = str(getattr(dtc.text, "text", dtc.text))
            yield CodeDescription(code=code_text(number), text=text, failure_type=number & 0xFF)


def _name(service: Any) -> str:  # noqa: ANN401 - see above
    """Return the long name of a service, or the short one with blanks for underscores, without its verb."""
    name = service.long_name or service.short_name.replace("_", " ")
    for verb in ("Read ", "Start "):
        name = name.removeprefix(verb)
    return str(name)


def _can_id(find: Any, layer: Any) -> int | None:  # noqa: ANN401 - a method of the library, and its owner
    """Return the identifier by the first of a controller's protocols that has one: DoIP has none."""
    for protocol in (None, *getattr(layer, "protocols", ())):
        with suppress(Exception):  # a file without parameters of communication
            if (can_id := find(protocol)) is not None:
                return int(can_id)
    return None


_TABLE: Final = read_table(Path(__file__).parent / "standard.toml", "the description", ConfigError)
_STANDARD: Final = record_from(DescriptionFile, _TABLE, error=ConfigError)
STANDARD_DATA: Final = _numbered(_STANDARD.data, "data")  # data of all makers
UNKNOWN: Final = Description(name=_STANDARD.name, data=STANDARD_DATA)
