"""What cantools makes of the text of a database, and what of a DBC text has to be left out before it does."""

import gc
import re
import traceback
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

import cantools
from cantools.database.can import Database, Message

from canlog.database.dbc_sieve import Offence, Sieve

MOST_SAID: Final = 1_000  # of offences, and of complaints, that are handed over
ParseError = cantools.Error
_UNMEANT: Final = (AttributeError, LookupError, TypeError, ValueError)
_RIDDLE: Final = "Cannot retrieve a child element"
_VALUE: Final = re.compile(r"'[^']{0,80}'$")
# Multiplexers that are none, multiplexed signals without one, and floats: what cantools takes as it comes.
_SUSPECT: Final = re.compile(r"\bSG_\s+\w+\s+m\w*\s*:|\bSG_MUL_VAL_\s+\d|\bSIG_VALTYPE_\s+\d")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parsed:
    database: Database | None  # None: offences speak against it
    offences: tuple[Offence, ...] = ()  # what was left out of a DBC file, or would have to be; the first of them
    offence_count: int = 0
    complaints: tuple[str, ...] = ()  # of cantools' strict check, one for each message


def parsed_dbc(text: str, *, is_lenient: bool) -> Parsed:
    """Return what comes of a DBC text; raises cantools.Error."""
    parsed, failure = None, None
    if not is_lenient:
        try:
            parsed = checked(text, "dbc")
        except cantools.Error as error:
            failure = ParseError(one_line(error))
        if parsed is not None and parsed.database is not None and not _may_be_misread(text, parsed.database):
            return parsed
        gc.collect()  # what the failed attempt left
    sieve = Sieve(text)
    if not sieve.has_messages and failure is not None:
        raise failure
    grave = [offence for offence in sieve.offences if not offence.is_harmless]
    if not is_lenient and grave:
        return Parsed(database=None, offences=tuple(grave[:MOST_SAID]), offence_count=len(grave))
    count, offences = len(sieve.offences), tuple(sieve.offences[:MOST_SAID])
    if parsed is not None:
        return parsed
    clean = sieve.text
    del sieve
    found = checked(clean, "dbc")
    return Parsed(database=found.database, offences=offences, offence_count=count, complaints=found.complaints)


def _may_be_misread(text: str, database: Database) -> bool:
    """Return whether a text that cantools takes calls for a thorough look."""
    if _SUSPECT.search(text):
        return True
    return any(len({signal.name for signal in message.signals}) < len(message.signals) for message in database.messages)


def checked(text: str, database_format: str) -> Parsed:
    """Return the database that cantools makes of a text, and what its strict check says; raises cantools.Error."""
    try:
        return Parsed(database=loaded(text, database_format, is_strict=True))
    except ParseError as error:
        if not isinstance(error.__cause__, ParseError):  # no matter of strictness
            raise
    database = loaded(text, database_format, is_strict=False)
    complaints = [complaint for message in database.messages for complaint in complaints_of(message)]
    return Parsed(database=database, complaints=tuple(complaints[:MOST_SAID]))


def loaded(text: str, database_format: str, *, is_strict: bool) -> Database:
    """Return the database that cantools makes of a text; raises cantools.Error."""
    database = cantools.database.load_string(text, database_format=database_format, strict=is_strict)
    if not isinstance(database, Database):
        raise ParseError("it holds no CAN messages")
    return database


def complaints_of(message: Message) -> list[str]:
    """Return what the strict check says of a message and those it contains."""
    complaints = []
    try:
        message.refresh(strict=True)
    except cantools.Error as error:
        complaints.append(one_line(error))
    for contained in message.contained_messages or ():
        complaints += complaints_of(contained)
    return complaints


def one_line(error: Exception) -> str:
    """Return what is wrong and where, on one line of bearable length, of cantools only what it meant to say."""
    cause = error.__cause__ or error
    frames = list(traceback.walk_tb(cause.__traceback__))[::-1]  # the innermost first
    text = " ".join(str(cause).split()) or type(cause).__name__
    last = traceback.extract_tb(cause.__traceback__)[-1:]
    is_meant = bool(last) and (last[0].line or "").startswith("raise")  # else Python raised it, at something unforeseen
    if text.startswith(_RIDDLE) or (isinstance(cause, _UNMEANT) and not is_meant):
        value = _VALUE.search(text) if isinstance(cause, ValueError) else None
        text = f"{value[0]} stands where a number has to be" if value else "something that it needs is missing"
    places = (_place(one) for frame, _ in frames for one in reversed(frame.f_locals.values()))
    place = next(filter(None, places), "")
    text = text if len(text) <= 160 else f"{text[:157]}..."
    return f"{text.rstrip('.')}, in {place}" if place else text


def _place(value: object) -> str:
    """Return the kind and the name of an element of XML, nothing of anything else."""
    if not isinstance(value, Element):
        return ""
    name = next((one.text for one in value if one.tag.endswith("}SHORT-NAME")), value.get("name"))
    return f"{value.tag.rpartition('}')[2]} {name[:80]}" if name else ""
