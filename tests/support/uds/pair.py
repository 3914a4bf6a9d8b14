"""Product and model side by side: everything happens to both, and they must say the same."""

from pathlib import Path
from random import Random

from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.server import advance, answer, broadcast, cycled, switched_on, tested, warmed_up
from ecu_emulator.diagnostics.services.call import under_control
from ecu_emulator.diagnostics.services.routines import finished
from ecu_emulator.diagnostics.state import Instant, Request
from tests.support.uds.full_table import full_table
from tests.support.uds.server_by_the_book import ServerByTheBook, table

PARKED = {
    "vehicle_speed_m_s": 0.0, "engine_speed_rad_s": 85.0, "sump_temperature_k": 353.0, "pedal_ratio": 0.0,
    "current_gear": 0.0, "brake_pressure_pa": 1e6, "engine_run_time_s": 60.0, "revs_possible": 1.0,
    "clearing_possible": 1.0, "adaptation_possible": 1.0,
}  # fmt: skip
SPOILED = {
    "vehicle_speed_m_s": 9.0, "engine_speed_rad_s": 0.0, "sump_temperature_k": 290.0, "pedal_ratio": 0.2,
    "current_gear": 2.0, "brake_pressure_pa": 0.0, "engine_run_time_s": 0.0, "revs_possible": 0.0,
    "clearing_possible": 0.0, "adaptation_possible": 0.0,
}  # fmt: skip
MORE = {
    "time_s": 12.34, "odometer_m": 45_678_901.0, "target_gear": 3.0, "engine_torque_nm": -12.3, "shift_count": 77.0,
    "clutch1_slip_rad_s": -3.2, "clutch2_slip_rad_s": 1e9, "clutch1_pressure_pa": 3.1e5, "clutch2_pressure_pa": -9e9,
    "clutch1_temperature_k": 390.2,
    "clutch1_touch_pressure_pa": 1.2e5,
}  # fmt: skip


class DisagreementError(AssertionError):
    """Product and model said different things."""


class Pair:
    """One emulated controller twice; ``folder`` is where its memory is between two starts."""

    def __init__(self, folder: Path) -> None:
        self.table = full_table()
        self.path = folder / "memory.json"
        self.path.unlink(missing_ok=True)
        self.t_s = 100.0
        self.values = {**PARKED, **MORE}
        self.state = switched_on(self.table, None, self.t_s)
        self.model = ServerByTheBook(table(), self.t_s)
        self.sampled: set[int] = set()
        self.answered = self.silent = self.repeated = 0
        self.nrcs: dict[int, int] = {}

    def ask(self, payload: bytes, chance: bytes, *, is_functional: bool = False) -> bytes | None:
        moment = Instant(t_s=self.t_s, values=self.values, chance=chance)
        reply = answer(self.table, self.state, Request(payload=payload, is_functional=is_functional), moment)
        expected = self.model.ask(payload, self.t_s, self.values, chance, is_functional=is_functional)
        self.state = reply.state
        self._note(reply.payload)
        self._agree(f"request {payload.hex()}{' to all' if is_functional else ''}", reply.payload, expected)
        return reply.payload

    def _note(self, response: bytes | None) -> None:
        if response is None:
            self.silent += 1
            return
        self.answered += 1
        if response[0] == 0x7F:
            self.nrcs[response[2]] = self.nrcs.get(response[2], 0) + 1

    def wait(self, duration_s: float) -> bytes | None:
        self.t_s += duration_s
        reply = advance(self.table, self.state, Instant(t_s=self.t_s, values=self.values))
        self.state = reply.state
        self._agree("time", reply.payload, self.model.tick(self.t_s, self.values))
        sent, self.state = broadcast(self.table, self.state, Instant(t_s=self.t_s, values=self.values))
        self.repeated += len(sent)
        self._agree("periodic", b"|".join(sent), b"|".join(self.model.repeat(self.t_s, self.values)))
        return reply.payload

    def sample(self, number: int, result: str) -> None:
        moment = Instant(t_s=self.t_s, values=self.values)
        self.state = tested(self.table, self.state, number, TestResult(result), moment)
        self.sampled.add(number)
        self.model.sample(number, result, self.values)
        self.check_codes(number)

    def cycle(self) -> None:
        self.state = cycled(self.table, self.state)
        self.model.cycle()
        self.check_codes()

    def warm_up(self) -> None:
        self.state = warmed_up(self.state)
        self.model.is_warm = True

    def finish(self, routine: int) -> None:
        self.state = finished(
            self.state,
            self.table,
            routine,
            under_control(self.table, self.state, Instant(t_s=self.t_s, values=self.values)),
        )
        self.model.finish(routine, self.values)

    def restart(self) -> None:
        """Take the current away, and give it again: what is not in the file is gone."""
        with MemoryFile(self.path, self.table) as store:
            store.save(self.state)
        with MemoryFile(self.path, self.table) as store:
            kept = store.load()
        self.state = switched_on(self.table, kept, self.t_s)
        self.model.restart(self.t_s)
        self.check_codes()

    def drive(self, random: Random) -> None:
        """Another moment of the vehicle: parked, but for one or two values that may be wrong or unknown."""
        self.values = {**PARKED, **MORE}
        for name in random.sample(sorted(PARKED), random.choice((0, 0, 0, 0, 0, 1, 2))):
            if random.random() < 0.1:
                del self.values[name]
            else:
                self.values[name] = SPOILED[name]

    def check_codes(self, *numbers: int) -> None:
        """Compare codes, those that ever had a result if none is named; what is read by 19 is compared anyway."""
        for number in numbers or self.sampled:
            trouble = self.model.troubles[number]
            record = self.state.memory.records[number]
            self._agree(f"status of {trouble.entry['code']}", bytes([record.status]), bytes([trouble.status]))
            self._agree(
                f"counter of {trouble.entry['code']}",
                record.detection_counter.to_bytes(2, "big", signed=True),
                trouble.counter.to_bytes(2, "big", signed=True),
            )

    def check_session(self) -> None:
        ours = (self.state.session, self.state.unlocked, self.state.are_codes_updated)
        theirs = (self.model.session, self.model.level, self.model.updates_codes)
        self._agree("session, security, setting", repr(ours).encode(), repr(theirs).encode())

    @staticmethod
    def _agree(what: str, ours: bytes | None, theirs: bytes | None) -> None:
        if ours != theirs:
            told = [said.hex(" ") if said is not None else "nothing" for said in (ours, theirs)]
            raise DisagreementError(f"{what}: the product says {told[0]}, the model {told[1]}")
