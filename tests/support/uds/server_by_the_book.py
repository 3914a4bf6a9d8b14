"""A server as ISO 14229-1 describes it in words: every service is a list of questions with what "no" is answered with.

It reads the table's TOML by itself and shares no code with the product. Its state is changed in place.
"""

import struct
import tomllib
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from typing import Any, TypeAlias

from tests.support.uds.full_table import full_text
from tests.support.uds.trouble_by_the_book import TroubleByTheBook

Questions: TypeAlias = Generator[tuple[bool, int], None, bytes]
Values: TypeAlias = Mapping[str, float]

QUIET = {0x11, 0x12, 0x31, 0x7E, 0x7F}
WITH_SUB_FUNCTION = {0x10, 0x11, 0x19, 0x27, 0x28, 0x2C, 0x31, 0x3E, 0x85}
PER_UNIT = {
    "rpm": lambda si: si * 30.0 / 3.141592653589793,
    "bar": lambda si: si / 100000.0,
    "degC": lambda si: si - 273.15,
    "km/h": lambda si: si * 3.6,
    "km": lambda si: si / 1000.0,
    "%": lambda si: si * 100.0,
}


@cache
def table() -> dict[str, Any]:
    return tomllib.loads(full_text())


@dataclass
class Run:
    until_s: float
    state: int = 1  # 0 ended, 1 runs, 2 stopped
    found: bytes = b""


class ServerByTheBook:
    def __init__(self, document: dict[str, Any], t_s: float) -> None:
        self.book = document
        self.by_number = {
            kind: {entry["number"]: entry for entry in document[kind]}
            for kind in ("session", "security", "service", "data", "routine", "extended")
        }
        self.troubles = {trouble.number: trouble for trouble in map(TroubleByTheBook, document["trouble"])}
        self.kept: dict[int, dict[int, list[tuple[bytes, bytes]]]] = {}
        self.written: dict[int, bytes] = {}
        self.wrong: dict[int, int] = {}
        self.is_warm = False
        self.silent_until_s = 0.0
        self.sensed: Values = {}
        self._power_up(t_s)

    def _power_up(self, t_s: float) -> None:
        self.session, self.level, self.s3_s = 1, 0, t_s
        self.seed: tuple[int, bytes] | None = None
        self.updates_codes = True
        self.traffic = {"normal": (True, True), "management": (True, True)}
        self.held: dict[int, bytes] = {}
        self.made: dict[int, list[tuple[int, int, int]]] = {}
        self.runs: dict[int, Run] = {}
        self.repeated: dict[int, list[float]] = {}  # period, next time
        self.awaited: tuple[bytes, int, float] | None = None
        self.barred = {
            number: t_s + entry["delay_s"]
            for number, entry in self.by_number["security"].items()
            if self.wrong.get(number, 0) >= entry["most_attempts"]
        }

    def restart(self, t_s: float) -> None:
        """Take the current away and give it again."""
        self._power_up(t_s)
        self.cycle()
        self.silent_until_s = 0.0

    # --- the vehicle ----------------------------------------------------------------------------------------------

    def cycle(self) -> None:
        for trouble in self.troubles.values():
            trouble.new_cycle(was_warm=self.is_warm)
        self.is_warm = False

    def sample(self, number: int, result: str, values: Values) -> None:
        trouble, values = self.troubles[number], self._as_held(values)
        if not self.updates_codes:
            return
        was_failed = trouble.status & 1
        had_data = trouble.has_data
        trouble.sample(result)
        if trouble.status & 1 and not was_failed:
            moment = (self._snapshot(trouble, values), self._fields(self.by_number["extended"][0x10]["fields"], values))
            before = self.kept.get(number, {}).get(0, []) if had_data else []
            self.kept[number] = {0: [*before[:1], moment]}

    def _snapshot(self, trouble: TroubleByTheBook, values: Values) -> bytes:
        numbers = trouble.entry.get("snapshot", self.book["snapshot"])
        pieces = [number.to_bytes(2, "big") + self._data(number, values) for number in numbers]
        return bytes([len(numbers)]) + b"".join(pieces)

    # --- time -----------------------------------------------------------------------------------------------------

    def _let_time_pass(self, t_s: float, values: Values) -> None:
        for number, run in self.runs.items():
            if run.state == 1 and t_s >= run.until_s:
                self._end(number, values, is_by_time=True)
        for number in [number for number, until_s in self.barred.items() if t_s >= until_s]:
            del self.barred[number]
            self.wrong[number] = self.by_number["security"][number]["most_attempts"] - 1
        if self.session != 1 and self.awaited is None and t_s - self.s3_s >= self.book["timing"]["s3_s"]:
            self._enter(1)
        self._give_up()

    def _end(self, number: int, values: Values, *, is_by_time: bool) -> None:
        run, entry = self.runs[number], self.by_number["routine"][number]
        if is_by_time and not entry.get("ends_by_itself", True):
            run.state = 2
            return
        run.state = 0
        run.found = self._fields(entry.get("results", []), values)

    def finish(self, number: int, values: Values) -> None:
        """Let the vehicle have done what a routine asked for."""
        values = self._as_held(values)
        if number in self.runs and self.runs[number].state == 1:
            self._end(number, values, is_by_time=False)

    def _as_held(self, values: Values) -> Values:
        """Return the values of a vehicle whose fluid temperature a tester may have taken over."""
        held = self.held.get(0x0206)
        others = {name: value for name, value in values.items() if name != "sump_temperature_k"}
        if held is None:
            return values
        return others if held == b"\xff" else {**others, "sump_temperature_k": held[0] - 40 + 273.15}

    def tick(self, t_s: float, values: Values) -> bytes | None:
        values = self._as_held(values)
        self._let_time_pass(t_s, values)
        if self.awaited is None:
            return None
        request, number, again_s = self.awaited
        if self.runs[number].state == 1:
            if t_s < again_s:
                return None
            self.awaited = (request, number, t_s + 0.7 * self.book["timing"]["p2_star_s"])
            return bytes([0x7F, request[0], 0x78])
        self.awaited, self.s3_s = None, t_s
        return bytes([0x71, request[1] & 0x7F]) + self._routine_info(number)

    # --- requests -------------------------------------------------------------------------------------------------

    def ask(self, r: bytes, t_s: float, values: Values, chance: bytes, *, is_functional: bool = False) -> bytes | None:
        if t_s < self.silent_until_s or not r:
            return None
        self.sensed, values = values, self._as_held(values)
        self._let_time_pass(t_s, values)
        if self.awaited is not None:
            return None if r == b"\x3e\x80" else bytes([0x7F, r[0], 0x21])
        self.s3_s = t_s
        nrc, data = self._outcome(r, t_s, values, chance)
        if nrc:
            return None if is_functional and nrc in QUIET else bytes([0x7F, r[0], nrc])
        if r[0] in WITH_SUB_FUNCTION and r[1] & 0x80:
            return None
        return bytes([r[0] + 0x40]) + data

    def _outcome(self, r: bytes, t_s: float, values: Values, chance: bytes) -> tuple[int, bytes]:
        questions = self._asked(r, t_s, values, chance)
        while True:
            try:
                is_fine, nrc = next(questions)
            except StopIteration as end:
                return 0, end.value
            if not is_fine:
                return nrc, b""

    def _asked(self, r: bytes, t_s: float, values: Values, chance: bytes) -> Questions:
        services: dict[int, Callable[[bytes, float, Values, bytes], Questions]] = {
            0x10: self._10, 0x11: self._11, 0x14: self._14, 0x19: self._19, 0x22: self._22, 0x27: self._27,
            0x28: self._28, 0x2A: self._2a, 0x2C: self._2c, 0x2E: self._2e, 0x2F: self._2f, 0x31: self._31,
            0x3E: self._3e, 0x85: self._85,
        }  # fmt: skip
        yield r[0] in services, 0x11
        service = self.by_number["service"][r[0]]
        yield self.session in service["sessions"], 0x7F
        if r[0] in WITH_SUB_FUNCTION:
            yield len(r) >= 2, 0x13
            sessions = self._sub_function_sessions(r[0], r[1] & 0x7F)
            yield bool(sessions), 0x12
            yield self.session in sessions, 0x7E
        return (yield from services[r[0]](r, t_s, values, chance))

    def _sub_function_sessions(self, sid: int, sub: int) -> list[int]:
        if sid == 0x10:
            entered = self.by_number["session"].get(sub)
            return list(entered["from_sessions"]) if entered else []
        if sid == 0x27:
            level = self.by_number["security"].get(sub if sub & 1 else sub - 1)
            return list(level["sessions"]) if level else []
        known = {
            0x11: {1, 2, 3}, 0x19: {1, 2, 3, 4, 6, 0x0A, 0x14, 0x1A}, 0x28: {0, 1, 2, 3}, 0x2C: {1, 3}, 0x31: {1, 2, 3},
            0x3E: {0}, 0x85: {1, 2},
        }  # fmt: skip
        return list(self.by_number["service"][sid]["sessions"]) if sub in known[sid] else []

    def _vehicle(self, names: list[str], values: Values) -> Questions:
        for name in names:
            condition = next(entry for entry in self.book["condition"] if entry["name"] == name)
            value = values.get(condition["source"])
            is_fine = value is not None and condition.get("minimum", -1e99) <= value <= condition.get("maximum", 1e99)
            yield is_fine, condition["nrc"]
        return b""

    def _service_conditions(self, sid: int, values: Values) -> Questions:
        return (yield from self._vehicle(self.by_number["service"][sid].get("conditions", []), values))

    def _access(self, name: str) -> dict[str, Any]:
        access: dict[str, Any] = self.book["access"][name]
        return access

    def _is_unlocked(self, access: dict[str, Any]) -> bool:
        return not access.get("levels") or self.level in access["levels"]

    def _10(self, r: bytes, _t_s: float, values: Values, _chance: bytes) -> Questions:
        yield len(r) == 2, 0x13
        yield from self._service_conditions(0x10, values)
        self._enter(r[1] & 0x7F)
        timing = self.book["timing"]
        p2, p2_star = round(timing["p2_s"] * 1000), round(timing["p2_star_s"] * 100)
        return bytes([r[1] & 0x7F, p2 >> 8, p2 & 255, p2_star >> 8, p2_star & 255])

    def _enter(self, session: int) -> None:
        self.session, self.level, self.seed = session, 0, None
        self.held = {}  # all that can be held needs security
        if session == 1:
            self.traffic = {"normal": (True, True), "management": (True, True)}
            self.updates_codes = True
            self.repeated = {}
            for run in self.runs.values():
                run.state = 2 if run.state == 1 else run.state

    def _11(self, r: bytes, t_s: float, values: Values, _chance: bytes) -> Questions:
        yield len(r) == 2, 0x13
        yield from self._service_conditions(0x11, values)
        self._power_up(t_s)
        if r[1] & 0x7F != 3:
            self.cycle()
        self.silent_until_s = t_s + self.book["timing"]["reset_s"]
        return bytes([r[1] & 0x7F])

    def _14(self, r: bytes, _t_s: float, values: Values, _chance: bytes) -> Questions:
        yield len(r) == 4, 0x13
        group = int.from_bytes(r[1:], "big")
        yield group == 0xFFFFFF or group in self.troubles, 0x31
        yield from self._service_conditions(0x14, values)
        for number, trouble in self.troubles.items():
            if group in {0xFFFFFF, number}:
                trouble.clear()
        return b""

    def _19(self, r: bytes, _t_s: float, _values: Values, _chance: bytes) -> Questions:
        report = r[1] & 0x7F
        length = {1: 3, 2: 3, 3: 2, 4: 6, 6: 6, 0x0A: 2, 0x14: 2, 0x1A: 3}[report]
        yield len(r) == length, 0x13
        if report in {4, 6}:
            number, name = int.from_bytes(r[2:5], "big"), r[5]
            yield number in self.troubles, 0x31
            yield name == 0xFF or name in ({1, 2} if report == 4 else self.by_number["extended"]), 0x31
            trouble = self.troubles[number]
            kept = self._snapshots(trouble, name) if report == 4 else self._extended(trouble, name)
            return bytes([report]) + r[2:5] + bytes([trouble.status]) + kept
        if report == 0x1A:
            own = self.by_number["extended"]
            able = [one for one in self.troubles.values() if r[2] in one.entry.get("extended", own)]
            yield bool(able), 0x31
            return b"\x1a\xff" + r[2:] + b"".join(self._code(one) + bytes([one.status]) for one in able)
        return bytes([report]) + self._report(report, r[2] if length == 3 else 0)

    def _report(self, report: int, mask: int) -> bytes:
        everyone = self.troubles.values()
        if report == 0x03:
            return b"".join(
                self._code(trouble) + bytes([name])
                for trouble in everyone if trouble.has_data for name in (1, 2)
            )  # fmt: skip
        if report == 0x14:
            return b"".join(
                self._code(trouble) + bytes([trouble.counter]) for trouble in everyone if 1 <= trouble.counter <= 126
            )
        chosen = [trouble for trouble in everyone if report == 0x0A or trouble.status & mask]
        if report == 0x01:
            return b"\xff\x00" + len(chosen).to_bytes(2, "big")
        return b"\xff" + b"".join(self._code(trouble) + bytes([trouble.status]) for trouble in chosen)

    @staticmethod
    def _code(trouble: TroubleByTheBook) -> bytes:
        return trouble.number.to_bytes(3, "big")

    def _snapshots(self, trouble: TroubleByTheBook, name: int) -> bytes:
        if not trouble.has_data:
            return b""
        moments = self.kept[trouble.number][0]
        both = {1: moments[0][0], 2: moments[-1][0]}
        return b"".join(bytes([which]) + data for which, data in both.items() if name in {which, 0xFF})

    def _extended(self, trouble: TroubleByTheBook, name: int) -> bytes:
        if not trouble.has_data:
            return b""
        good = trouble.good_since
        lamp_cycles = (
            trouble.entry.get("heal_cycles", 3) if trouble.entry["lights_lamp"] and trouble.is_confirmed else 0
        )
        records = {
            0x01: bytes([trouble.occurrences]),
            0x02: bytes([sum(cycle.is_warm for cycle in good[lamp_cycles:])]),
            0x03: bytes([trouble.bad_in_a_row(len(trouble.cycles) - 1), len(good[:lamp_cycles])]),
            0x10: self.kept[trouble.number][0][-1][1],
        }
        return b"".join(bytes([which]) + data for which, data in records.items() if name in {which, 0xFF})

    # --- data -----------------------------------------------------------------------------------------------------

    def _data(self, number: int, values: Values) -> bytes:
        entry = self.by_number["data"][number]
        if number in self.held:
            return self.held[number]
        if "initial" not in entry:
            return self._fields(entry["fields"], values)
        is_text = entry["fields"][0]["kind"] == "text"
        initial: str = entry["initial"]
        return self.written.get(number) or (initial.encode() if is_text else bytes.fromhex(initial))

    def _fields(self, fields: list[dict[str, Any]], values: Values) -> bytes:
        written = b""
        for entry in fields:
            is_signed, bits = entry["kind"] == "signed", 8 * entry["size_bytes"]
            value = float(self.session) if entry["source"] == "active_session" else values.get(entry["source"])
            if entry["kind"] == "float":
                written += struct.pack(">d", float("nan") if value is None else value)
                continue
            highest = 2 ** (bits - 1) - 1 if is_signed else 2**bits - 2
            if value is None:
                number = -(2 ** (bits - 1)) if is_signed else 2**bits - 1
            else:
                shown = PER_UNIT.get(entry.get("unit", ""), float)(value)
                steps = round((shown - entry.get("offset", 0.0)) / entry.get("resolution", 1.0))
                number = min(highest, max(-highest if is_signed else 0, steps))
            written += number.to_bytes(entry["size_bytes"], "big", signed=is_signed)
        return written

    def _size(self, number: int) -> int:
        return sum(entry["size_bytes"] for entry in self.by_number["data"][number]["fields"])

    def _is_readable_here(self, number: int) -> bool:
        entry = self.by_number["data"].get(number)
        return entry is not None and self.session in self._access(entry["read"])["sessions"]

    def _22(self, r: bytes, _t_s: float, values: Values, _chance: bytes) -> Questions:
        yield 3 <= len(r) <= 1 + 2 * self.book["limits"]["most_data"] and len(r) % 2 == 1, 0x13
        names = [int.from_bytes(r[place : place + 2], "big") for place in range(1, len(r), 2)]
        found = b""
        for name in names:
            pieces = self.made.get(name) or ([(name, 1, self._size(name))] if name in self.by_number["data"] else [])
            if not pieces or not all(self._is_readable_here(source) for source, _, _ in pieces):
                continue
            for source, _, _ in pieces:
                yield self._is_unlocked(self._access(self.by_number["data"][source]["read"])), 0x33
            parts = [self._data(source, values)[start - 1 : start - 1 + size] for source, start, size in pieces]
            found += name.to_bytes(2, "big") + b"".join(parts)
        yield bool(found), 0x31
        yield 1 + len(found) <= self.book["limits"]["most_response_bytes"], 0x14
        return found

    def _parts(self, name: int) -> list[tuple[int, int, int]]:
        """Return what can be read under a name in this session: source, first byte from 1, length."""
        parts = self.made.get(name) or ([(name, 1, self._size(name))] if name in self.by_number["data"] else [])
        return parts if all(self._is_readable_here(source) for source, _, _ in parts) else []

    def _fits_a_frame(self, name: int) -> bool:
        return 1 <= sum(size for _, _, size in self._parts(name)) <= 7

    def _is_open(self, name: int) -> bool:
        reads = [self.by_number["data"][source]["read"] for source, _, _ in self._parts(name)]
        return all(self._is_unlocked(self._access(read)) for read in reads)

    def _2a(self, r: bytes, t_s: float, values: Values, _chance: bytes) -> Questions:
        yield len(r) >= 3 or r[1:] == b"\4", 0x13
        yield 1 <= r[1] <= 4, 0x31
        wanted = [0xF200 + low for low in r[2:] if self._fits_a_frame(0xF200 + low)]
        yield bool(wanted) or len(r) == 2, 0x31
        if r[1] == 4:
            for name in wanted or list(self.repeated):
                self.repeated.pop(name, None)
            return b""
        for name in wanted:
            yield self._is_open(name), 0x33
        yield len({*self.repeated, *wanted}) <= self.book["periodic"]["most"], 0x31
        yield from self._service_conditions(0x2A, values)
        period_s = self.book["periodic"][("slow_s", "medium_s", "fast_s")[r[1] - 1]]
        for name in wanted:
            self.repeated[name] = [period_s, t_s]
        return b""

    def _give_up(self) -> None:
        """Stop what may not be read any more."""
        for name in list(self.repeated):
            if self.session == 1 or not self._fits_a_frame(name) or not self._is_open(name):
                del self.repeated[name]

    def repeat(self, t_s: float, values: Values) -> list[bytes]:
        """Return what is sent now without having been asked for again."""
        values = self._as_held(values)
        self._let_time_pass(t_s, values)
        sent = []
        for name, times in self.repeated.items():
            period_s, next_s = times
            if t_s >= next_s:
                parts = [self._data(source, values)[b - 1 : b - 1 + size] for source, b, size in self._parts(name)]
                sent.append(bytes([name - 0xF200]) + b"".join(parts))
                times[1] = next_s + period_s if next_s + period_s > t_s else t_s + period_s
        return sent

    def _2c(self, r: bytes, _t_s: float, _values: Values, _chance: bytes) -> Questions:
        name = int.from_bytes(r[2:4], "big")
        if r[1] & 0x7F == 3:
            yield len(r) in {2, 4}, 0x13
            yield len(r) == 2 or (0xF200 <= name <= 0xF3FF and name not in self.by_number["data"]), 0x31
            self.made = {} if len(r) == 2 else {made: parts for made, parts in self.made.items() if made != name}
            return bytes([3]) + r[2:]
        yield len(r) >= 8 and len(r) % 4 == 0, 0x13
        yield 0xF200 <= name <= 0xF3FF and name not in self.by_number["data"], 0x31
        parts = [(int.from_bytes(r[p : p + 2], "big"), r[p + 2], r[p + 3]) for p in range(4, len(r), 4)]
        for source, start, size in parts:
            yield self._is_readable_here(source), 0x31
            yield start >= 1 and size >= 1 and start - 1 + size <= self._size(source), 0x31
        yield sum(map(len, self.made.values())) + len(parts) <= self.book["limits"]["most_pieces"], 0x31
        for source, _, _ in parts:
            yield self._is_unlocked(self._access(self.by_number["data"][source]["read"])), 0x33
        self.made[name] = [*self.made.get(name, []), *parts]
        return bytes([1]) + r[2:4]

    def _2e(self, r: bytes, _t_s: float, values: Values, _chance: bytes) -> Questions:
        yield len(r) >= 4, 0x13
        number, data = int.from_bytes(r[1:3], "big"), r[3:]
        entry = self.by_number["data"].get(number, {})
        yield "write" in entry and self.session in self._access(entry["write"])["sessions"], 0x31
        yield len(data) == self._size(number), 0x13
        yield self._is_unlocked(self._access(entry["write"])), 0x33
        yield self._is_sensible(entry["fields"], data), 0x31
        yield from self._service_conditions(0x2E, values)
        yield from self._vehicle(self._access(entry["write"]).get("conditions", []), values)
        self.written[number] = data
        return r[1:3]

    @staticmethod
    def _is_sensible(fields: list[dict[str, Any]], data: bytes) -> bool:
        """Whether data of one field, as all that can be written have, may be written."""
        entry = fields[0]
        if entry["kind"] == "bytes":  # a date
            try:
                datetime.strptime(data.hex(), "%y%m%d").replace(tzinfo=UTC)
            except ValueError:
                return False
            return True
        if entry["kind"] == "text":
            letters = "ABCDEFGHJKLMNPRSTUVWXYZ" if "HJ-NPR" in entry["pattern"] else "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
            return all(chr(byte) in letters + "0123456789" for byte in data)
        value = int.from_bytes(data, "big") * entry.get("resolution", 1.0) + entry.get("offset", 0.0)
        return bool(entry.get("minimum", -1e99) <= value <= entry.get("maximum", 1e99))

    def _2f(self, r: bytes, _t_s: float, values: Values, _chance: bytes) -> Questions:
        yield len(r) >= 4, 0x13
        number, action, wanted = int.from_bytes(r[1:3], "big"), r[3], r[4:]
        entry = self.by_number["data"].get(number, {})
        yield "control" in entry and self.session in self._access(entry["control"])["sessions"], 0x31
        yield self._is_unlocked(self._access(entry["control"])), 0x33
        yield action in {0, 2, 3}, 0x31
        yield len(wanted) == (self._size(number) if action == 3 else 0), 0x13
        yield from self._service_conditions(0x2F, values)
        yield from self._vehicle(self._access(entry["control"]).get("conditions", []), values)
        if action == 0:
            self.held.pop(number, None)
        else:
            self.held[number] = wanted if action == 3 else self._data(number, values)
        return r[1:4] + self._data(number, self.sensed)

    # --- security, routines, the rest -----------------------------------------------------------------------------

    def _27(self, r: bytes, t_s: float, _values: Values, chance: bytes) -> Questions:
        sub = r[1] & 0x7F
        number = sub if sub & 1 else sub - 1
        level = self.by_number["security"][number]
        size = level["seed_bytes"]
        if sub & 1:
            yield len(r) == 2, 0x13
            if self.level == number:
                return bytes([sub]) + bytes(size)
            yield number not in self.barred, 0x37
            self.seed = (number, chance[:size])
            return bytes([sub]) + chance[:size]
        yield len(r) == 2 + size, 0x13
        yield self.seed is not None and self.seed[0] == number, 0x24
        seed = int.from_bytes(self.seed[1] if self.seed else b"", "big")
        self.seed = None
        is_right = int.from_bytes(r[2:], "big") == seed ^ level["key_mask"]
        self.wrong[number] = 0 if is_right else self.wrong.get(number, 0) + 1
        if self.wrong[number] >= level["most_attempts"]:
            self.barred[number] = t_s + level["delay_s"]
            yield False, 0x36
        yield is_right, 0x35
        self.level = number
        return bytes([sub])

    def _28(self, r: bytes, _t_s: float, values: Values, _chance: bytes) -> Questions:
        yield len(r) == 3, 0x13
        yield r[2] & 0x0F in {1, 2, 3} and r[2] >> 4 in {0, 15}, 0x31
        sub = r[1] & 0x7F
        if sub:
            yield from self._service_conditions(0x28, values)
        switches = {0: (True, True), 1: (True, False), 2: (False, True), 3: (False, False)}[sub]  # receive, send
        for bit, which in ((1, "normal"), (2, "management")):
            if r[2] & bit:
                self.traffic[which] = switches
        return bytes([sub])

    def _routine_info(self, number: int) -> bytes:
        run = self.runs[number]
        return number.to_bytes(2, "big") + bytes([run.state]) + run.found

    def _31(self, r: bytes, t_s: float, values: Values, _chance: bytes) -> Questions:
        sub = r[1] & 0x7F
        yield len(r) >= 4, 0x13
        number, options = int.from_bytes(r[2:4], "big"), r[4:]
        entry = self.by_number["routine"].get(number, {})
        yield bool(entry) and self.session in self._access(entry["access"])["sessions"], 0x31
        access = self._access(entry["access"])
        yield self._is_unlocked(access), 0x33
        yield sub != 2 or entry.get("can_be_stopped", True), 0x12
        wanted = entry.get("options", []) if sub == 1 else []
        yield len(options) == sum(field["size_bytes"] for field in wanted), 0x13
        is_running = number in self.runs and self.runs[number].state == 1
        yield {1: not is_running, 2: is_running, 3: number in self.runs}[sub], 0x24
        if sub == 1:
            yield (
                all(field["minimum"] <= byte <= field["maximum"] for field, byte in zip(wanted, options, strict=True)),
                0x31,
            )
            yield from self._service_conditions(0x31, values)
            yield from self._vehicle(access.get("conditions", []), values)
            self.runs[number] = Run(until_s=t_s + entry["duration_s"])
            if entry.get("is_awaited", False):
                self.awaited = (r, number, t_s + 0.7 * self.book["timing"]["p2_star_s"])
                yield False, 0x78
        elif sub == 2:
            self.runs[number].state = 2
        return bytes([sub]) + self._routine_info(number)

    def _3e(self, r: bytes, _t_s: float, _values: Values, _chance: bytes) -> Questions:
        yield len(r) == 2, 0x13
        return b"\x00"

    def _85(self, r: bytes, _t_s: float, values: Values, _chance: bytes) -> Questions:
        yield len(r) in {2, 5}, 0x13
        yield r[2:] in {b"", b"\xff\xff\xff"}, 0x31
        if r[1] & 0x7F == 2:
            yield from self._service_conditions(0x85, values)
        self.updates_codes = r[1] & 0x7F == 1
        return bytes([r[1] & 0x7F])
