"""A client that knows a controller by its PDX alone, read by odxtools: asks everything, decodes every answer."""

import io
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from random import Random
from typing import Any, TypeAlias
from unittest.mock import patch

from jinja2 import Environment
from odxtools.database import Database
from odxtools.diaglayers.diaglayer import DiagLayer
from odxtools.diagservice import DiagService
from odxtools.dtcdop import DtcDop
from odxtools.endofpdufield import EndOfPduField
from odxtools.message import Message
from odxtools.structure import Structure

from tests.tools.pdx.elements import UNDEFINED
from tests.tools.pdx.package import pdx_package
from workshop.controller.descriptions import Values
from workshop.controller.memory import TestResult
from workshop.controller.server import advance, answer, switched_on, tested
from workshop.controller.services.sessions import finished, key_of
from workshop.controller.state import Instant, Request, ServerState
from workshop.controller.table import DiagnosticTable

PARKED = {
    "vehicle_speed_m_s": 0.0, "engine_speed_rad_s": 85.0, "sump_temperature_k": 353.0, "pedal_ratio": 0.0,
    "current_gear": 0.0, "brake_pressure_pa": 1e6, "engine_run_time_s": 60.0, "revs_possible": 1.0,
    "clearing_possible": 1.0, "adaptation_possible": 1.0,
}  # fmt: skip
MORE = {
    "time_s": 12.34, "odometer_m": 45_678_901.0, "target_gear": 3.0, "engine_torque_nm": -12.3, "shift_count": 77.0,
    "clutch1_slip_rad_s": -3.2, "clutch2_slip_rad_s": 1e9, "clutch1_pressure_pa": 3.1e5, "clutch2_pressure_pa": -9e9,
    "clutch1_temperature_k": 390.2,
    "clutch1_touch_pressure_pa": 1.2e5,
}  # fmt: skip
SEED = bytes(range(1, 17))
PENDING = 0x78
T_S = 1000.0
MIXED = 10  # requests whose parameters are chosen by chance, each for itself
Dop: TypeAlias = Any  # one of many classes without a common interface


@dataclass
class Figures:
    requests: Counter[str] = field(default_factory=Counter)  # by service of the PDX
    positive: Counter[str] = field(default_factory=Counter)
    negative: Counter[str] = field(default_factory=Counter)
    nrcs: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)


def read_back(package: bytes, container: int = 0) -> DiagLayer:
    """Return the controller that odxtools finds in a PDX: first what UDS reaches, then OBD."""
    database = Database(use_weakrefs=False)
    database.add_pdx_file(io.BytesIO(package))
    database.refresh()
    return database.diag_layer_containers[container].base_variants[0]


@contextmanager
def templates_compiled_once() -> Iterator[None]:
    """Have each template of odxtools compiled once while this is entered, which is most of the work of a package."""
    plain, found = Environment.compile, dict[tuple[object, object], Any]()

    def compiled(self: Environment, source: Any, name: Any = None, *more: Any) -> Any:  # noqa: ANN401
        if (name, source) not in found:
            found[name, source] = plain(self, source, name, *more)
        return found[name, source]

    with patch.object(Environment, "compile", compiled):
        yield


class PdxClient:
    """One controller, its PDX, and a client between them."""

    def __init__(
        self, table: DiagnosticTable, random: Random, values: Values | None = None, *, container: int = 0
    ) -> None:
        self.table = table
        self.random = random
        self.package = pdx_package(table)
        self.layer = read_back(self.package, container)
        self.moment = Instant(t_s=T_S, values={**PARKED, **MORE} if values is None else values, chance=SEED)
        self.figures = Figures()
        self.codes: dict[tuple[str, bytes, bytes | None], str | None] = {}

    def ask_everything(self, most_situations: int | None = None) -> Figures:
        """Ask each service in every situation, or some by chance, with every choice of its parameters."""
        states = list(self.situations())
        if most_situations is not None:
            states = self.random.sample(states, most_situations)
        for service in self.layer.services:
            assert isinstance(service, DiagService)
            for parameters in self.parameters(service):
                for state in states:
                    self.exchange(service, parameters, state)
        return self.figures

    # --- situations ---------------------------------------------------------------------------------------------------

    def asked(self, state: ServerState, request: bytes) -> tuple[bytes | None, ServerState]:
        reply = answer(self.table, state, Request(payload=request), self.moment)
        return reply.payload, reply.state

    def situations(self) -> Iterator[ServerState]:
        """Yield a new controller, then one with codes, in each session, locked and not, with data and routines."""
        state = switched_on(self.table, None, T_S)
        yield state
        for result in (TestResult.FAILED, TestResult.PASSED, TestResult.FAILED):
            for number in list(self.table.troubles)[::2]:
                state = tested(self.table, state, number, result, self.moment)
        for number in list(self.table.troubles)[1::2]:
            state = tested(self.table, state, number, TestResult.PREFAILED, self.moment)
        yield state
        for session in self.table.sessions:
            entered = replace(state, session=session)
            yield entered
            for number, level in self.table.levels.items():
                yield replace(entered, seed_level=number, seed=SEED[: level.seed_bytes])
                unlocked = self.busy(replace(entered, unlocked=number))
                yield unlocked
                done = unlocked
                for routine in done.routines:
                    done = finished(done, self.table, routine, self.moment)
                yield done

    def busy(self, state: ServerState) -> ServerState:
        """Return a state with a datum defined and all routines running that can be started."""
        for datum in list(self.table.data)[:1]:
            _, state = self.asked(state, b"\x2c\x01\xf3\x00" + datum.to_bytes(2, "big") + b"\x01\x01")
        for number, routine in self.table.routines.items():
            options = b"".join(
                max(1, round(entry.minimum or 0)).to_bytes(entry.size_bytes, "big") for entry in routine.options
            )
            _, state = self.asked(state, b"\x31\x01" + number.to_bytes(2, "big") + options)
            state = replace(state, waiting=None)
        return state

    # --- parameters ---------------------------------------------------------------------------------------------------

    def parameters(self, service: DiagService) -> Iterator[dict[str, Any]]:
        """Yield what a request can be filled with: every choice once at least, others by chance."""
        assert service.request is not None
        free = service.request.free_parameters
        choices = [self.choices(getattr(parameter, "dop", None), service) for parameter in free]
        for place in range(max(map(len, choices), default=1)):
            names = (parameter.short_name for parameter in free)
            yield dict(zip(names, (some[place % len(some)] for some in choices), strict=True))
        for _ in range(MIXED if len(free) > 1 else 0):
            yield {part.short_name: self.random.choice(some) for part, some in zip(free, choices, strict=True)}

    def choices(self, dop: Dop, service: DiagService) -> list[Any]:
        if isinstance(dop, DtcDop):
            return list(dop.dtcs)
        if isinstance(dop, EndOfPduField):
            items = self.choices(dop.structure, service)
            most = dop.max_number_of_items or 3
            together = [items[place : place + most] for place in range(0, len(items), most)]
            return [[item] for item in items[:5]] + [*together, self.random.choices(items, k=min(most, 3))]
        if isinstance(dop, Structure):
            parts = {part.short_name: self.choices(getattr(part, "dop", None), service) for part in dop.parameters}
            count = max(map(len, parts.values()))
            return [{name: some[place % len(some)] for name, some in parts.items()} for place in range(count)]
        return self.simple_choices(dop, service)

    def simple_choices(self, dop: Dop, service: DiagService) -> list[Any]:
        if dop.compu_method.category.value == "TEXTTABLE":
            texts = [scale.compu_const.vt for scale in dop.compu_method.compu_internal_to_phys.compu_scales]
            return [text for text in texts if text != UNDEFINED]
        size = dop.diag_coded_type.bit_length // 8
        date = bytes.fromhex("260131").rjust(size, b"\0")[-size:]
        raws = [
            bytes(size),
            b"\x01".rjust(size, b"\0"),
            b"0" * size,
            date,
            *(self.random.randbytes(size) for _ in range(2)),
        ]
        if service.semantic == "SECURITY":
            raws += [key_of(level, SEED[:size]) for level in self.table.levels.values() if level.seed_bytes == size]
        return [self.physical(dop, data) for data in raws]

    @staticmethod
    def physical(dop: Dop, data: bytes) -> object:
        """Return a value in its unit from bytes of the wire."""
        match dop.diag_coded_type.base_data_type.value:
            case "A_ASCIISTRING":
                return data.decode("latin-1")
            case "A_FLOAT32" | "A_FLOAT64":
                return struct.unpack(">f" if len(data) == 4 else ">d", data)[0]
            case "A_BYTEFIELD":
                return data
            case data_type:
                number = int.from_bytes(data, "big", signed=data_type == "A_INT32")
                return dop.compu_method.convert_internal_to_physical(number)

    # --- exchange -----------------------------------------------------------------------------------------------------

    def exchange(self, service: DiagService, parameters: dict[str, Any], state: ServerState) -> None:
        """Encode a request, let the controller answer, decode: nothing may be left over on the way."""
        request = bytes(service.encode_request(**parameters))
        self.figures.requests[service.short_name] += 1
        response, state = self.asked(state, request)
        self.check(service, request, response)
        if response is not None and response[0] == 0x7F and response[2] == PENDING:
            state = finished(state, self.table, int.from_bytes(request[2:4], "big"), self.moment)
            self.check(service, request, advance(self.table, state, self.moment).payload)

    def check(self, service: DiagService, request: bytes, response: bytes | None) -> None:
        """Decode a response, once if it comes in several situations, and count it."""
        exchanged = (service.short_name, request, response)
        if exchanged not in self.codes:
            self.codes[exchanged] = self.decoded(service, request, response)
        code = self.codes[exchanged]
        if code is None:
            return
        if code:
            self.figures.nrcs[code] += 1
        (self.figures.negative if code else self.figures.positive)[service.short_name] += 1

    def decoded(self, service: DiagService, request: bytes, response: bytes | None) -> str | None:
        """Return the negative response code in words, empty if positive; None if something is wrong."""
        what = f"{service.short_name} ({request.hex(' ')}): {response.hex(' ') if response else 'nothing'}"
        if response is None:
            self.figures.problems.append(f"{what}: not answered")
            return None
        try:
            message = service.decode_message(response)
            sent_again = encoded(message, request)
            in_layer = self.taken_for(service, request, response)
        except Exception as exc:  # noqa: BLE001 - whatever the library says is a finding
            self.figures.problems.append(f"{what}: {exc}")
            return None
        if sent_again != response:
            self.figures.problems.append(f"{what}: means {sent_again.hex(' ')}")
        if service.short_name not in in_layer:
            self.figures.problems.append(f"{what}: taken for the answer to {in_layer}")
        if sent_again != response or service.short_name not in in_layer:
            return None
        return str(message.param_dict["response_code"]) if response[0] == 0x7F else ""

    def taken_for(self, service: DiagService, request: bytes, response: bytes) -> list[str]:
        """Return the services to whose requests this could be a response, among all of the controller.

        odxtools looks at how a request begins, and so takes one of several data for that of its first alone.
        """
        if service.short_name.startswith("Read_several"):
            return [service.short_name]
        return [found.service.short_name for found in self.layer.decode_response(response, request)]


def encoded(message: Message, request: bytes) -> bytes:
    """Return the bytes of a decoded response anew."""
    coding: Any = message.coding_object  # a response
    free = [part.short_name for part in coding.parameters if part.parameter_type == "VALUE"]
    return bytes(coding.encode(request, **{name: message.param_dict[name] for name in free}))
