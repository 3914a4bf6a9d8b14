"""Tables of frames whose columns are named by a header or by ``--columns``; assumptions become notes."""

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canlog.errors import SourceError
from canlog.frames import Frame, FrameBatch
from canlog.logs.columns.lines import DAY_US, DECIMAL, HEXADECIMAL, Column, FileClock, Layout, LineReader, Role
from canlog.logs.dates import date_us
from canlog.logs.log_counts import MICROSECONDS, MILLISECONDS, SECONDS, UNIT_NAMES, likely_unit
from canlog.logs.text_kernels import MOST_CHANNELS, SKIPPED
from canlog.logs.text_log import LineLog, frames_of

SEPARATORS: Final = b",;\t|"
MOST_COLUMNS: Final = 200
NANOSECONDS: Final = -3
UNITS: Final[Mapping[str, int]] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), SECONDS),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), MILLISECONDS),
    **dict.fromkeys(("us", "µs", "usec", "micros", "microseconds"), MICROSECONDS),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), NANOSECONDS),
}
BASES: Final[Mapping[str, int]] = {"hex": HEXADECIMAL, "dec": DECIMAL, "decimal": DECIMAL}
ROLE_OF_NAME: Final[Mapping[str, Role]] = {
    "time": Role.TIME,
    "id": Role.ID,
    "data": Role.DATA,
    "length": Role.LENGTH,
    "channel": Role.CHANNEL,
    "extended": Role.EXTENDED,
    "remote": Role.REMOTE,
    "error": Role.ERROR,
    "fd": Role.FD,
    "brs": Role.BIT_RATE_SWITCH,
    "esi": Role.ERROR_STATE,
    "direction": Role.DIRECTION,
}
"""What columns are called on the command line."""

# What columns are called in the wild, without blanks, marks and units, the best name first.
SYNONYMS: Final[Mapping[Role, tuple[str, ...]]] = {
    Role.TIME: (
        "timestamp", "abstime", "absolutetime", "timeabs", "time", "datetime", "epoch", "timestampepoch",
        "timeoffset", "systemtime", "t", "zeit", "zeitstempel", "temps", "offset", "reltime", "relativetime",
        "unixtime", "unixtimestamp", "epochtime", "unix",
    ),
    Role.ID: (
        "id", "canid", "arbitrationid", "arbid", "identifier", "messageid", "msgid", "frameid", "canidentifier",
        "arbitrationidentifier", "addr", "address", "canaddress", "idhex", "iddec",
    ),
    Role.DATA: (
        "data", "databytes", "payload", "datafield", "candata", "bytes", "datahex", "datadec", "hexdata",
        "rawdata", "databyte", "daten", "message",
    ),
    Role.LENGTH: (
        "dlc", "len", "length", "datalength", "datalen", "datalengthcode", "size", "nbytes", "bytecount", "lng",
        "messagelength", "msglen",
    ),
    Role.CHANNEL: (
        "bus", "channel", "chn", "chan", "ch", "can", "interface", "network", "port", "busid", "canbus",
        "canchannel", "kanal", "buschannel", "channelid", "busnumber", "channelnumber",
    ),
    Role.EXTENDED: (
        "extended", "ext", "xtd", "ide", "isextended", "isextendedid", "extendedid", "eff", "frameformat",
        "idtype", "format",
    ),
    Role.REMOTE: ("remote", "rtr", "isremote", "isremoteframe", "remoteframe"),
    Role.ERROR: ("error", "er", "err", "iserror", "iserrorframe", "errorframe"),
    Role.FD: ("fd", "isfd", "canfd", "fdf", "edl"),
    Role.BIT_RATE_SWITCH: ("brs", "bitrateswitch"),
    Role.ERROR_STATE: ("esi", "errorstateindicator"),
    Role.DIRECTION: ("dir", "direction", "rxtx", "txrx", "tx", "transmit", "richtung"),
}  # fmt: skip
BYTE_NAME: Final = re.compile(r"(?:d|b|db|data|byte|databyte|datab)(\d{1,2})")
NUMBER_IN_BRACKETS: Final = re.compile(r"[\[(](\d+)[)\]]")
NO_BASE: Final = 0  # of identifiers: found out by their digits
UNIT_IN_BRACKETS: Final = re.compile(r"[\[(](?P<unit>[^)\]]*)[)\]]")
MARKS: Final = re.compile(r"[\W_]+")
LARGEST_ID: Final = 0x1FFF_FFFF
LARGEST_STANDARD_ID: Final = 0x7FF
FEWEST_LONG_DIGITS: Final = 7  # of identifiers of 29 bits, whose priority is above zero
LEAST_LETTERED: Final = 0.1  # of hexadecimal identifiers; fewer are damage
BARE: Final = re.compile(r"[0-9A-Fa-f]{1,10}")  # without 0x, and h or x behind it
CABANA: Final = frozenset({"time", "addr", "bus", "data"})
PANDA: Final = frozenset({"bus", "messageid", "message"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """What columns are taken for, in their order; ``has_unit``: the header has the unit of times."""

    columns: tuple[Column, ...]
    names: tuple[str, ...]
    has_unit: bool

    def in_words(self) -> str:
        """Return what the columns are taken for, as ``--columns`` takes it."""
        spelled = {role: name for name, role in ROLE_OF_NAME.items()}
        parts = [
            f"{spelled[column.role]}={name}"
            for column, name in zip(self.columns, self.names, strict=True)
            if column.role in spelled
        ]
        bytes_ = [name for column, name in zip(self.columns, self.names, strict=True) if column.role is Role.BYTE]
        return ",".join([*parts, *([f"data={bytes_[0]}-{bytes_[-1]}"] if bytes_ else [])])


def separator_of(line: bytes) -> int:
    """Return the character that separates the columns of a header: the one that occurs most."""
    return max(SEPARATORS, key=line.count)


def names_in(line: bytes, separator: int) -> tuple[str, ...]:
    text = line.decode("utf-8", "replace").strip("\r\n")
    try:
        fields = next(csv.reader([text], delimiter=chr(separator), skipinitialspace=True), [])
    except csv.Error:
        return ()
    while fields and not fields[-1].strip():
        fields.pop()
    return tuple(field.strip() for field in fields[:MOST_COLUMNS])


def proposal(names: Sequence[str]) -> Proposal | None:
    """Return what a header's names say of its columns; None unless there are an identifier and bytes among them."""
    columns = named_columns(names)
    has_bytes = any(column.role in {Role.DATA, Role.BYTE} for column in columns)
    if not has_bytes or not any(column.role is Role.ID for column in columns):
        return None
    time_names = [name for column, name in zip(columns, names, strict=True) if column.role is Role.TIME]
    has_unit = any(_unit_in(name) is not None for name in time_names)
    return Proposal(columns=columns, names=tuple(names), has_unit=has_unit)


def named_columns(names: Sequence[str]) -> tuple[Column, ...]:
    """Return what names say of columns; those of which they say nothing are ignored ones."""
    plain = [_plain(name) for name in names]
    columns = [Column()] * len(names)
    for role, synonyms in SYNONYMS.items():
        place = next((plain.index(synonym) for synonym in synonyms if synonym in plain), None)
        if place is not None and columns[place].role is Role.IGNORED:
            columns[place] = Column(role, _parameter(role, names[place]))
    if not any(column.role is Role.TIME for column in columns):
        for place in [place for place, word in enumerate(plain) if "time" in word and "cycle" not in word][:1]:
            if columns[place].role is Role.IGNORED:
                columns[place] = Column(Role.TIME, _parameter(Role.TIME, names[place]))
    if not any(column.role is Role.DATA for column in columns):
        for place in _byte_places(plain):
            columns[place] = Column(Role.BYTE, _parameter(Role.BYTE, names[place]))
    return tuple(columns)


def chosen(choice: str, names: Sequence[str]) -> Proposal:
    """Return what ``time=Time,id=ID,data=D1-D8`` says of columns with these names, or of numbered ones.

    Raises SourceError if a role or a column is not known, or the identifier or the bytes are missing.
    """
    most = max((int(word) for word in re.findall(r"\d+", choice) if int(word) <= MOST_COLUMNS), default=0)  # no header
    columns, has_unit, folded = [Column()] * max(len(names), most), False, {name.casefold() for name in names}
    for part in filter(None, map(str.strip, choice.split(","))):
        word, _, rest = part.partition("=")
        role = ROLE_OF_NAME.get(word.strip().lower())
        if role is None or not rest.strip():
            raise SourceError(f"--columns {part!r}: say what is what as {'|'.join(ROLE_OF_NAME)}=COLUMN")
        name, mark, option = rest.strip().rpartition(":")
        if not mark or rest.strip().casefold() in folded:  # a colon that is part of a name
            name, option = rest.strip(), ""
        option, places = option.strip().lower(), _places(name, names)
        column_role = Role.BYTE if role is Role.DATA and len(places) > 1 else role
        if role is not Role.DATA and len(places) > 1:
            raise SourceError(f"--columns {part!r}: only data may be several columns")
        for place in places:
            columns[place] = Column(column_role, _chosen_parameter(column_role, option, _name_at(names, place), part))
        has_unit |= role is Role.TIME and (bool(option) or _unit_in(_name_at(names, places[0])) is not None)
    roles = {column.role for column in columns}
    if Role.ID not in roles or roles.isdisjoint({Role.DATA, Role.BYTE}):
        raise SourceError(f"--columns {choice!r} names no {'id' if Role.ID not in roles else 'data'}; {_seen(names)}")
    shown = tuple(_name_at(names, place) or str(place + 1) for place in range(len(columns)))
    return Proposal(columns=tuple(columns), names=shown, has_unit=has_unit)


def base_of(values: Iterable[str], names: Sequence[str]) -> tuple[int, str]:
    """Return the base of identifiers under a header, and the reason if that is worth a note."""
    bare = sorted({value for value in values if BARE.fullmatch(value)})
    plain = [value for value in bare if value.isdigit()]
    lettered = len(bare) - len(plain)
    words = {name.casefold() for name in names}
    tells_kind = any(column.role is Role.EXTENDED for column in named_columns(names))  # else the digits tell it
    between = (
        []
        if tells_kind
        else [digits for digits in plain if int(digits, 16) > LARGEST_STANDARD_ID and len(digits) < FEWEST_LONG_DIGITS]
    )
    base, why = HEXADECIMAL, "nothing shows that they are decimal (--columns id=...:dec says so)"
    if not plain or lettered >= LEAST_LETTERED * len(bare):
        why = ""
    elif any(len(value) > 1 and value.startswith("0") for value in plain):
        why = "they have leading zeros"
    elif words == CABANA or words >= PANDA:
        base, why = DECIMAL, f"its header is {'Cabana' if words == CABANA else 'Panda'}'s"
    elif lettered:
        base, why = DECIMAL, f"{lettered} of {len(bare)} has letters"
    elif any(int(value, 16) > LARGEST_ID for value in plain):
        base, why = DECIMAL, "as hexadecimal they would be too large"
    elif between:
        base, why = DECIMAL, f"as hexadecimal {between[0]} is too large for 11 bits, and too short for 29"
    return base, why


def are_numbers(choice: str) -> bool:
    """Return whether columns are named by nothing but their numbers."""
    named = [part.partition("=")[2].partition(":")[0].strip() for part in choice.split(",") if part.strip()]
    return bool(named) and all(re.fullmatch(r"\d+(?:(?:-|\.\.)\d+)?", column) for column in named)


def in_unit(columns: Sequence[Column], unit: int) -> tuple[Column, ...]:
    return tuple(replace(column, parameter=unit) if column.role is Role.TIME else column for column in columns)


def _plain(name: str) -> str:
    name = NUMBER_IN_BRACKETS.sub(r"\1", name)
    bare = MARKS.sub("", UNIT_IN_BRACKETS.sub("", name).casefold())
    unit = _unit_behind(name)
    return bare.removesuffix(unit) if unit else bare or MARKS.sub("", name.casefold())


def _unit_behind(name: str) -> str:
    """Return the unit that stands behind a mark at the end of a name, such as ``time_ms``."""
    last = re.split(r"[\s_.-]", name.strip().casefold())[-1]
    return last if last in UNITS and last != MARKS.sub("", name.casefold()) else ""


def _unit_in(name: str) -> int | None:
    """Return the unit in a name, as a power of ten in microseconds."""
    bracketed = UNIT_IN_BRACKETS.search(name)
    word = bracketed["unit"].strip().casefold() if bracketed else _unit_behind(name)
    return UNITS.get(word)


def _base_in(name: str) -> int:
    words = set(MARKS.split(name.casefold()))
    return next((base for word, base in BASES.items() if words & {word, f"id{word}", f"data{word}"}), NO_BASE)


def _parameter(role: Role, name: str) -> int:
    if role is Role.TIME:
        unit = _unit_in(name)
        return SECONDS if unit is None else unit
    if role in {Role.DATA, Role.BYTE}:
        return _base_in(name) or HEXADECIMAL
    return _base_in(name) if role is Role.ID else 0


def _chosen_parameter(role: Role, option: str, name: str, part: str) -> int:
    if not option:
        return _parameter(role, name)
    known = UNITS if role is Role.TIME else BASES if role in {Role.ID, Role.DATA, Role.BYTE} else {}
    if option not in known:
        wanted = "s, ms, us, ns" if role is Role.TIME else "hex, dec" if known else "nothing"
        raise SourceError(f"--columns {part!r}: behind the colon can stand {wanted}")
    return known[option]


def _byte_places(plain: Sequence[str]) -> list[int]:
    """Return where the columns of single bytes stand: as many as there are in a row, from number 0 or 1."""
    place_of = {int(match[1]): place for place, name in enumerate(plain) if (match := BYTE_NAME.fullmatch(name))}
    number = min(place_of, default=2)
    places = list[int]()
    while number <= 1 + len(places) and number in place_of:
        places.append(place_of[number])
        number += 1
    return places if places == sorted(places) else []


def _places(text: str, names: Sequence[str]) -> list[int]:
    """Return the places of a column, or of all from one to another; raises SourceError if it is not there."""
    place = _place(text, names)
    if place is not None:
        return [place]
    for dash in re.finditer(r"\.\.|-", text):
        first, last = _place(text[: dash.start()], names), _place(text[dash.end() :], names)
        if first is not None and last is not None and first <= last:
            return list(range(first, last + 1))
    raise SourceError(f"--columns: there is no column {text!r}; {_seen(names)}")


def _place(text: str, names: Sequence[str]) -> int | None:
    wanted = text.strip().casefold()
    folded = [name.casefold() for name in names]
    if wanted in folded:
        return folded.index(wanted)
    is_number = wanted.isascii() and wanted.isdigit() and 0 < int(wanted) <= MOST_COLUMNS
    return int(wanted) - 1 if is_number and (not names or int(wanted) <= len(names)) else None


def _name_at(names: Sequence[str], place: int) -> str:
    return names[place] if place < len(names) else ""


def _seen(names: Sequence[str]) -> str:
    return f"its columns are {', '.join(map(repr, names))}" if names else "it has no header: name columns by number"


LEAST_COLUMNS: Final = 2
CONTROLS: Final = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")  # that no header of a table holds
LEAST_RISING: Final = 0.9  # of all steps of a clock; a few may fall where it begins again
COMMENTS: Final = b"#"


def is_list(batch: FrameBatch, columns: Sequence[Column]) -> bool:
    """Return whether frames are listed, not recorded: no times rise, no identifier comes again, beside them are notes.

    Where nothing stands beside them, it is a list if all have but one byte, which then is a count.
    """
    steps_ns, roles = np.diff(batch.t_ns), {column.role for column in columns}
    has_times = not len(steps_ns) or bool(steps_ns.any() and np.mean(steps_ns >= 0) >= LEAST_RISING)
    if Role.TIME in roles and has_times:
        return False
    is_bare = Role.IGNORED in roles or batch.length.max(initial=0) <= 1
    return is_bare and (len(np.unique(batch.can_id)) > len(batch) // 2 or not batch.length.any())


HEADER_LINES_LOOKED_AT = 200  # Vehicle Spy lists up to a hundred networks before
SAMPLE_LINES = 2_000
ENOUGH_BYTES = 8  # of a table without lengths: a frame with so many is whole
HALF_BYTE_AT_END = {HEXADECIMAL: re.compile(rb"[^0-9A-Fa-f][0-9A-Fa-f]\n"), DECIMAL: re.compile(rb"[^0-9][0-9]{1,2}\n")}
WHOLE_BYTE_AT_END = re.compile(rb"[0-9A-Fa-f]{2}[\"\s]*$")
LABELLED = re.compile(rb"\d+\.\d+,[0-9A-Fa-f]{3,8},[0-8](?:,[0-9A-Fa-f]{2}){0,8},[RT]\s*")  # R: regular, T: injected
LABELLED_COLUMNS = "time=1:s,id=2:hex,length=3,data=4-11"  # of HCRL's car hacking data set, which has no header
CLOCK = re.compile(r"\d{1,2}:\d\d:\d\d")
DATE = re.compile(r"\d{4}[-/]\d\d[-/]\d\d[ T]\d{1,2}:\d\d:\d\d(?:[.,]\d+)?(?P<offset>\S*)$")
NO_HEADER = "no line names its columns"
NO_TIMES = "the log has no times: every frame gets the time 1970-01-01 00:00:00"
NO_LAYOUT = Layout(columns=(Column(),), separator=ord(","))


class TableLog(LineLog):
    """A table of a known layout; `set_layout` changes it, before the first line or because of a line."""

    def __init__(self, layout: Layout = NO_LAYOUT) -> None:
        super().__init__()
        self._clock = FileClock()
        self.set_layout(layout)

    def set_layout(self, layout: Layout) -> None:
        """Read the lines that follow by a layout."""
        self.layout, self._reader, self._header_lines = layout, LineReader(layout), layout.header_lines
        self._clock.wrap_us = layout.wrap_us

    def set_base(self, base_us: int, now_us: int = 0, *, is_relative: bool = False) -> None:
        """Count times from here, of which so much has passed; each from the one before if ``is_relative``."""
        self._clock = FileClock(base_us=base_us, now_us=now_us, wrap_us=self.layout.wrap_us, is_relative=is_relative)

    def read_line(self, line: bytes) -> Frame | int:
        """Read a line; a comment of an exact layout is for ``read_comment``."""
        if self._header_lines > 0:
            self._header_lines -= 1
            return SKIPPED
        return self._reader.read(line, self._clock)

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:
        """Return whether no byte can be missing, and no digit of the last one."""
        layout = self.layout
        tells_length = layout.has(Role.LENGTH) or layout.has(Role.LENGTH_CODE)
        if frame.length[0] < (1 if tells_length else ENOUGH_BYTES):
            return False
        if layout.is_exact:
            last = layout.columns[-1]
            return last.role is not Role.DATA or HALF_BYTE_AT_END[last.parameter].search(line[-4:]) is None
        places = [place for place, column in enumerate(layout.columns) if column.role in {Role.DATA, Role.BYTE}]
        is_followed = len(names_in(line, layout.separator)) > places[-1] + 1 if places else False
        return is_followed or WHOLE_BYTE_AT_END.search(line) is not None


class ColumnsLog(TableLog):
    """A table of separated columns, whose header names them, or ``choice``: ``time=Time,id=ID,data=D1-D8``."""

    def __init__(self, choice: str = "") -> None:
        super().__init__()
        self._choice = choice
        self.columns_text = ""

    def look_ahead(self, text: bytes) -> None:
        """Find the header, and out of the first lines what it leaves open; raises SourceError if it cannot be used."""
        lines = text.splitlines()
        number, separator, header = _header_of(lines, self._choice)
        body = lines[number : number + SAMPLE_LINES]
        rows = [names_in(line, separator) for line in body if line.strip() and not line.startswith(COMMENTS)]
        self.columns_text = header.in_words()
        columns = tuple(self._based(column, place, rows, header.names) for place, column in enumerate(header.columns))
        id_digits = {len(value.lower().removeprefix("0x")) for value in _values(columns, Role.ID, rows)}
        self.set_layout(
            Layout(
                columns=columns,
                separator=separator,
                comment_starts=COMMENTS,
                header_lines=number,
                extended_digits=8 if 8 in id_digits and id_digits & {3, 4} else 0,  # where others have 3, or 4
                has_decimal_comma=separator != ord(","),
                names=header.names,
                channel_names=self._channel_names(_values(columns, Role.CHANNEL, rows)),
            )
        )
        self._set_time_unit(header, rows, b"\n".join(body))

    def _based(self, column: Column, place: int, rows: Sequence[tuple[str, ...]], names: Sequence[str]) -> Column:
        """Return a column with its numbers in the base that they must have."""
        if column.role is not Role.ID or column.parameter != NO_BASE:
            return column
        base, why = base_of((row[place] for row in rows if place < len(row)), names)
        if why:
            self.notes.append(f"identifiers are taken as {'decimal' if base == DECIMAL else 'hexadecimal'}: {why}")
        return replace(column, parameter=base)

    def _channel_names(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of channels in the order they came, none if the numbers at their ends tell them apart."""
        first_names = tuple(dict.fromkeys(names))[:MOST_CHANNELS]
        if len({(re.search(r"\d*$", name) or [""])[0] for name in first_names}) == len(first_names):
            return ()
        self.notes.append(
            f"channels are numbered by name: {', '.join(f'{n} {name}' for n, name in enumerate(first_names))}"
        )
        return first_names

    def _set_time_unit(self, header: Proposal, rows: Sequence[tuple[str, ...]], body: bytes) -> None:
        """Find out what the times count, and from when."""
        layout = self.layout
        times = _values(layout.columns, Role.TIME, rows)
        if not layout.has(Role.TIME):
            self.notes.append(NO_TIMES)
        elif times and (date := DATE.match(times[0])):
            if not date["offset"]:
                self._set_local_dates(times[0])
        elif times and CLOCK.match(times[0]):
            self.set_layout(replace(layout, wrap_us=DAY_US))
            self.notes.append("times are times of day, taken as those of 1970-01-01")
        elif times and not header.has_unit:
            unit = SECONDS  # where they have fractions; else a unit that gives a plausible load
            if not any("." in time or "," in time for time in times):
                counted = replace(layout, columns=in_unit(layout.columns, MICROSECONDS), header_lines=0)
                unit = likely_unit(frames_of(TableLog(counted), body))[0]
            self.notes.append(f"times are taken as {UNIT_NAMES[unit]}: the header does not say")
            self.set_layout(replace(layout, columns=in_unit(layout.columns, unit)))

    def _set_local_dates(self, date: str) -> None:
        """Take dates without an offset as local time, all with the offset of the first."""
        local_us = date_us(date.replace("T", " ").replace("/", "-").encode())
        layout = Layout(columns=(Column(Role.TIME), Column(Role.ID, 16)), separator=ord(";"))
        as_utc = frames_of(TableLog(layout), date.encode() + b";1")
        if local_us is not None and len(as_utc):
            self.set_base(local_us - int(as_utc.t_ns[0]) // 1_000)
            self.notes.append("dates are taken as local time: they have no UTC offset")


def header_names(text: bytes) -> tuple[str, ...]:
    """Return the names of the columns of what looks like a table; none if it does not."""
    for line in text.splitlines()[:HEADER_LINES_LOOKED_AT]:
        separator = separator_of(line)
        names = names_in(line, separator)
        is_text = CONTROLS.search(line) is None
        if len(names) > LEAST_COLUMNS and all(name and not _is_number(name) for name in names) and is_text:
            return names
    return ()


def _header_of(lines: Sequence[bytes], choice: str) -> tuple[int, int, Proposal]:
    """Return how many lines there are up to the header, the separator, and what the columns are taken for."""
    if choice and are_numbers(choice):
        return _numbered(lines, choice)
    complaint: SourceError | None = None
    for number, line in enumerate(lines[:HEADER_LINES_LOOKED_AT], 1):
        separator = separator_of(line)
        names = names_in(line, separator)
        if len(names) < LEAST_COLUMNS or all(_is_number(name) for name in names):
            continue
        if not choice:
            if header := proposal(names):
                return _behind_headers(lines, number, separator, names), separator, header
            continue
        try:
            header = chosen(choice, names)
            return _behind_headers(lines, number, separator, names), separator, header
        except SourceError as exc:
            complaint = complaint or exc
    sample = [line for line in lines if line.strip()][:HEADER_LINES_LOOKED_AT]
    if not choice and sum(LABELLED.fullmatch(line) is not None for line in sample) * 2 > len(sample):
        return _numbered(lines, LABELLED_COLUMNS)
    raise complaint or SourceError(NO_HEADER)


def _behind_headers(lines: Sequence[bytes], number: int, separator: int, names: Sequence[str]) -> int:
    """Return how many lines there are up to the last header: one for another network begins with the same columns."""
    while number < len(lines) and names_in(lines[number], separator)[:LEAST_COLUMNS] == names[:LEAST_COLUMNS]:
        number += 1
    return number


def _numbered(lines: Sequence[bytes], choice: str) -> tuple[int, int, Proposal]:
    """Return the same for columns that are named by their numbers: the header ends before the first frame."""
    first_line = next((line for line in lines if line.strip() and not line.startswith(COMMENTS)), b"")
    separator = separator_of(first_line)
    header = chosen(choice, ())
    columns = tuple(
        replace(column, parameter=HEXADECIMAL) if column.role is Role.ID else column for column in header.columns
    )
    reader = TableLog(Layout(columns=columns, separator=separator, has_decimal_comma=separator != ord(",")))
    numbers = range(min(len(lines), HEADER_LINES_LOOKED_AT))
    first = next((number for number in numbers if len(frames_of(reader, lines[number]))), 0)
    return first, separator, header


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", ".").removeprefix("0x"))
    except ValueError:
        return False
    return True


def _values(columns: Sequence[Column], role: Role, rows: Sequence[tuple[str, ...]]) -> list[str]:
    place = next((place for place, column in enumerate(columns) if column.role is role), None)
    return [] if place is None else [row[place] for row in rows if place < len(row) and row[place]]
