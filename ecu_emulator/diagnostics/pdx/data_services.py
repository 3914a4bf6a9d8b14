"""Services 22, 2C, 2E and 2F for a tool: data by identifier."""

from collections.abc import Iterator
from typing import Final

from ecu_emulator.diagnostics.codes import Service as Number
from ecu_emulator.diagnostics.descriptions import Access, Datum
from ecu_emulator.diagnostics.pdx.coded_types import rest, unsigned, worded
from ecu_emulator.diagnostics.pdx.dictionary import Dictionary
from ecu_emulator.diagnostics.pdx.parameters import Parameter, constant, echo, value
from ecu_emulator.diagnostics.pdx.service import Service, access_to, simple
from ecu_emulator.diagnostics.services.data import (
    ADJUST,
    CLEAR_DEFINITION,
    DEFINABLE_PAGE,
    DEFINE_BY_IDENTIFIER,
    FREEZE,
    RETURN_CONTROL,
)
from ecu_emulator.diagnostics.services.periodic import FAST, MEDIUM, SLOW, STOP
from ecu_emulator.diagnostics.table import PERIODIC_PAGE, DiagnosticTable

_RATES: Final = {SLOW: "Slow", MEDIUM: "Medium", FAST: "Fast", STOP: "Stop"}
_ACTIONS: Final = {RETURN_CONTROL: "Return", FREEZE: "Freeze", ADJUST: "Adjust"}


class DataNames:
    """What the dictionary calls the data of a table."""

    def __init__(self, table: DiagnosticTable, dictionary: Dictionary) -> None:
        self.structures = {datum.number: dictionary.fields(datum.name, datum.fields) for datum in table.data.values()}
        self.number = dictionary.simple("number of a datum", unsigned(2, is_hexadecimal=True))
        self.low = dictionary.simple("lower byte of a number", unsigned(1, is_hexadecimal=True))
        labels = {datum.number: f"{datum.number:04X} {datum.name}" for datum in table.data.values()}
        self.choice = dictionary.simple("data", worded(labels, 16)) if labels else self.number

    def content(self, datum: Datum) -> Parameter:
        """Return a parameter that holds a datum."""
        return value(datum.name, self.structures[datum.number], datum.size_bytes)


def reading_services(table: DiagnosticTable, dictionary: Dictionary, names: DataNames) -> Iterator[Service]:
    """Yield a service to read each datum, one to read several, and one to read what a client has defined."""
    for datum in table.data.values():
        number = constant("identifier", datum.number, 2, "ID")
        yield Service(
            name=f"Read {datum.name}",
            number=Number.READ_DATA,
            semantic="CURRENTDATA" if datum.initial is None else "IDENTIFICATION",
            request=(number,),
            responses=((number, names.content(datum)),),
            access=access_to(table, Number.READ_DATA, datum.read),
        )
    left = dictionary.simple("bytes of a defined datum", rest(1))
    yield _several(table, dictionary, names, left)
    for page, name in _pages(table).items():
        defined = constant("page", page, semantic="ID")
        yield Service(
            name=f"Read defined {name}",
            number=Number.READ_DATA,
            semantic="CURRENTDATA",
            request=(defined, value("number", names.low, 1)),
            responses=((defined, echo("number", 2, 1), value("bytes", left)),),
            access=access_to(table, Number.READ_DATA),
        )


def _pages(table: DiagnosticTable) -> dict[int, str]:
    """Return upper bytes of data that clients may define."""
    periodic = {} if table.periodic is None else {PERIODIC_PAGE: "periodic data"}
    return {DEFINABLE_PAGE: "data", **periodic}


def _several(table: DiagnosticTable, dictionary: Dictionary, names: DataNames, left: str) -> Service:
    asked = dictionary.structure("asked datum", (value("identifier", names.choice, 2),))
    other = dictionary.structure("other data", (value("bytes", left),))
    switch = dictionary.switched("read data by identifier", names.number, 2, names.structures, other)
    found = dictionary.structure("read datum", (value("datum", switch),))
    return Service(
        name="Read several data",
        number=Number.READ_DATA,
        semantic="CURRENTDATA",
        request=(value("data", dictionary.repeated("asked data", asked, table.limits.most_data, 1)),),
        responses=((value("data", dictionary.repeated("read data", found, table.limits.most_data, 1)),),),
        access=access_to(table, Number.READ_DATA),
    )


def periodic_services(table: DiagnosticTable, dictionary: Dictionary, names: DataNames) -> Iterator[Service]:
    """Yield a service for each rate at which data are sent again and again, and two to stop it."""
    datum = dictionary.structure("periodic datum", (value("number", names.low, 1),))
    data = (value("data", dictionary.repeated("periodic data", datum, least=1)),)
    rates: dict[str, tuple[int, tuple[Parameter, ...]]] = {
        f"{verb} periodic data": (mode, data) for mode, verb in _RATES.items()
    }
    rates["Stop all periodic data"] = (STOP, ())
    for name, (mode, asked) in rates.items():
        yield Service(
            name=name,
            number=Number.READ_PERIODICALLY,
            semantic="PERIODIC",
            request=(constant("mode", mode), *asked),
            access=access_to(table, Number.READ_PERIODICALLY),
        )


def defining_services(table: DiagnosticTable, dictionary: Dictionary, names: DataNames) -> Iterator[Service]:
    """Yield the services that make data of pieces of others, and forget them."""
    byte = dictionary.simple("number of bytes", unsigned(1))
    piece = dictionary.structure(
        "piece of a datum", (value("source", names.choice, 2), value("first_byte", byte, 1), value("bytes", byte, 1))
    )
    pieces = value("pieces", dictionary.repeated("pieces of data", piece, table.limits.most_pieces, 1))
    access, number, kind = access_to(table, Number.DEFINE_DATA), Number.DEFINE_DATA, "DYN-DEF-MESSAGE"
    for page, name in _pages(table).items():
        upper = constant("page", page, semantic="ID")
        asked, response = (upper, value("number", names.low, 1)), (upper, echo("number", 3, 1))
        define, clear = DEFINE_BY_IDENTIFIER, CLEAR_DEFINITION
        yield simple(f"Define {name}", number, define, kind, access, request=(*asked, pieces), response=response)
        yield simple(f"Forget defined {name}", number, clear, kind, access, request=asked, response=response)
    yield simple("Forget all defined data", number, CLEAR_DEFINITION, kind, access)


def writing_services(table: DiagnosticTable, _dictionary: Dictionary, names: DataNames) -> Iterator[Service]:
    """Yield a service to write each datum that can be written."""
    for datum in table.data.values():
        if datum.write is None:
            continue
        number = constant("identifier", datum.number, 2, "ID")
        yield Service(
            name=f"Write {datum.name}",
            number=Number.WRITE_DATA,
            semantic="STOREDDATA",
            request=(number, names.content(datum)),
            responses=((number,),),
            access=access_to(table, Number.WRITE_DATA, datum.write),
        )


def controlling_services(table: DiagnosticTable, _dictionary: Dictionary, names: DataNames) -> Iterator[Service]:
    """Yield the services that take a datum out of the controller's hands."""
    for datum in table.data.values():
        if datum.control is not None:
            yield from _controls(table, datum, names.content(datum), datum.control)


def _controls(table: DiagnosticTable, datum: Datum, content: Parameter, control: Access) -> Iterator[Service]:
    for action, name in _ACTIONS.items():
        begin = constant("identifier", datum.number, 2, "ID"), constant("action", action)
        yield Service(
            name=f"{name} {datum.name}",
            number=Number.CONTROL_DATA,
            semantic="CONTROL",
            request=(*begin, content) if action == ADJUST else begin,
            responses=((*begin, content),),
            access=access_to(table, Number.CONTROL_DATA, control),
        )
