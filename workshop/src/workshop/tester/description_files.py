"""Descriptions of controllers in files: TOML, or ODX (ISO 22901-1), which odxtools reads."""

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, TypeVar

from canlog.extras import load_extra
from canlog.files import check_plain_file
from clutch_model.tables import read_table, record_from
from diag_service.errors import ConfigError
from workshop.tester.addresses import LARGEST_ID
from workshop.tester.answers import POSITIVE, READ_DATA, ROUTINE
from workshop.tester.description import (
    STANDARD_DATA,
    UNKNOWN,
    Coding,
    Datum,
    Description,
    Field,
    Reader,
    Routine,
    Trouble,
    Value,
    Values,
    code_text,
)

PDX_SUFFIXES: Final = frozenset({".pdx", ".odx-d", ".odx"})
FOLDER: Final = Path(__file__).parent / "controllers"
MOST_BYTES: Final = 256 * 2**20
_START: Final = 0x01
_HEAD_BYTES: Final = 3  # of a response to service 22: the service and the number of the datum


_NumberedT = TypeVar("_NumberedT", Datum, Routine)


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """By which datum a controller is known, and what it says there."""

    number: int
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DescriptionFile:
    """What a TOML file may hold."""

    name: str
    request_id: int | None = None
    response_id: int | None = None
    identity: Identity | None = None
    data: tuple[Datum, ...] = ()
    extended: tuple[Datum, ...] = ()
    trouble: tuple[Trouble, ...] = ()
    routine: tuple[Routine, ...] = ()

    def __post_init__(self) -> None:
        for can_id in (self.request_id, self.response_id):
            if can_id is not None and not 0 <= can_id <= LARGEST_ID:
                raise ConfigError(f"request_id and response_id must be 0..0x{LARGEST_ID:X}, got {can_id}")

    @property
    def description(self) -> Description:
        """The controller that it describes, and what controllers of all makers have besides."""
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
    """Return a description by its path or by the name of one that ships; without one, what all controllers have.

    Raises ConfigError if there is none, or it cannot be used, ExtraMissingError if it is a PDX and odxtools is not
    installed.
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
    """Return what a TOML file holds; raises ConfigError naming the first key that is wrong."""
    table = read_table(path, "the description", ConfigError)
    try:
        described = record_from(DescriptionFile, table, error=ConfigError)
        _ = described.description
    except ConfigError as exc:
        raise ConfigError(f"description {path}: {exc}") from exc
    return described


def _numbered(records: Iterable[_NumberedT], what: str) -> Mapping[int, _NumberedT]:
    found: dict[int, _NumberedT] = {}
    for record in records:
        if record.number in found:
            raise ConfigError(f"{what} 0x{record.number:04X} is there twice")
        found[record.number] = record
    return found


def load_odx(path: Path) -> Description:
    """Return the controller that a PDX package or an ODX file describes: its first base or controller variant.

    Raises ConfigError if the file cannot be read, or describes no controller, ExtraMissingError if odxtools is not
    installed.
    """
    extra = "odx" if find_spec("udsoncan") else "odx,uds"
    odxtools = load_extra("odxtools", "PDX files need odxtools", extra, "./workshop")
    try:
        check_plain_file(path, MOST_BYTES)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what a maker's file does not keep of the standard
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
    routines = dict[int, Routine]()
    for service, request in _constant_requests(layer):
        number = int.from_bytes(request[-2:], "big")
        if request[0] == READ_DATA and len(request) == _HEAD_BYTES:
            responses = service.positive_responses
            bits = responses[0].get_static_bit_length() if responses else None  # None: not always the same
            size_bytes = 0 if bits is None else max(0, bits // 8 - _HEAD_BYTES)
            whole = Field(name="bytes", kind=Coding.BYTES, size_bytes=size_bytes)
            data[number] = Datum(number=number, name=_name(service), fields=(whole,))
            readers[number] = _reader(service, number)
        elif request[:2] == bytes([ROUTINE, _START]) and len(request) == 1 + _HEAD_BYTES:
            routines[number] = Routine(number=number, name=_name(service))
    return Description(
        name=layer.short_name,
        data={**STANDARD_DATA, **data},
        troubles=tuple(_troubles(layer)),
        routines=routines,
        request_id=_or_none(layer.get_can_receive_id),
        response_id=_or_none(layer.get_can_send_id),
        readers=readers,
    )


def _constant_requests(layer: Any) -> Iterator[tuple[Any, bytes]]:  # noqa: ANN401 - see above
    """Yield the services of which the beginning of the request is fixed, with that."""
    for service in layer.services:
        if getattr(service, "request", None) is not None:
            prefix = bytes(service.request.coded_const_prefix())
            if len(prefix) >= _HEAD_BYTES:
                yield service, prefix


def _reader(service: Any, number: int) -> Reader:  # noqa: ANN401 - see above
    head = bytes([READ_DATA + POSITIVE]) + number.to_bytes(2, "big")

    def read(data: bytes) -> Values:
        try:
            found = service.decode_message(head + data).param_dict
        except Exception:  # noqa: BLE001 - whatever the library makes of bytes that do not fit the file
            return {"": data.hex(" ").upper()}
        fixed = {part.short_name for part in service.positive_responses[0].parameters if part.parameter_type != "VALUE"}
        values = list(_flat({name: value for name, value in found.items() if name not in fixed}))
        inner = Counter(path[-1] for path, _ in values)
        return {path[-1] if inner[path[-1]] == 1 else " ".join(path): value for path, value in values}

    return read


def _flat(value: object, path: tuple[str, ...] = ("",)) -> Iterator[tuple[tuple[str, ...], Value]]:
    """Yield the values within nested ones, each with its names, the innermost last."""
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


def _troubles(layer: Any) -> Iterator[Trouble]:  # noqa: ANN401 - see above
    dictionary = layer.diag_data_dictionary_spec
    seen = set[int]()
    for dop in () if dictionary is None else dictionary.dtc_dops:
        for dtc in dop.dtcs:
            number = int(dtc.trouble_code)
            if number in seen:
                continue
            seen.add(number)
            text = str(getattr(dtc.text, "text", dtc.text))
            yield Trouble(code=code_text(number), text=text, failure_type=number & 0xFF)


def _name(service: Any) -> str:  # noqa: ANN401 - see above
    """Return what people call a service: its long name, or the short one without what stands for blanks."""
    name = service.long_name or service.short_name.replace("_", " ")
    for verb in ("Read ", "Start "):
        name = name.removeprefix(verb)
    return str(name)


def _or_none(find: Any) -> int | None:  # noqa: ANN401 - a method of the library
    try:
        found = find()
    except Exception:  # noqa: BLE001 - a file without parameters of communication
        return None
    return None if found is None else int(found)
