"""Descriptions of controllers from files: TOML tables of ours, and PDX packages of ODX."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from clutch_model.tables import read_table, record_from
from diag_service.errors import ConfigError, ControllerError, PendingError
from diag_service.tester.addresses import LARGEST_ID
from diag_service.tester.answers import READ_DATA
from diag_service.tester.description import STANDARD_DATA, UNKNOWN, Datum, Description, Routine, Trouble

if TYPE_CHECKING:
    from diag_service.tester.dialogue import Dialogue


PDX_SUFFIXES: Final = frozenset({".pdx", ".odx-d", ".odx"})


def recognised(tester: "Dialogue", description: Description = UNKNOWN) -> Description:
    """Return a description; without one the shipped one that fits, or else what all controllers have.

    Without one it asks for a datum or two.
    """
    if description is not UNKNOWN:
        return description
    for described in shipped():
        if described.identity is None:
            continue
        try:
            response = tester.ask(bytes([READ_DATA]) + described.identity.number.to_bytes(2, "big"))
        except PendingError:  # whoever asks next would wait as long
            raise
        except ControllerError:  # it will not tell, or not answer: the question that follows says so
            continue
        if response[3:].rstrip(b"\0 ").decode("latin-1") == described.identity.text:
            return described.description
    return UNKNOWN


FOLDER: Final = Path(__file__).parent / "controllers"


class _Numbered(Protocol):
    @property
    def number(self) -> int: ...


_NumberedT = TypeVar("_NumberedT", bound=_Numbered)


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

    Raises
    ------
    ConfigError
        If there is none, or it cannot be used.
    ExtraMissingError
        If it is a PDX and odxtools is not installed.
    """
    if name is None:
        return UNKNOWN
    if name.suffix.lower() in PDX_SUFFIXES:
        from diag_service.tester.odx import load_odx  # noqa: PLC0415 - a large library, for few

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
    """Return the descriptions that ship with the service."""
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
