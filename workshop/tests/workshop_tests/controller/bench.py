"""A controller on a bench: requests and responses as hexadecimal text, the time and the vehicle in the test's hands."""

from tests.support.uds.full_table import full_table
from workshop.controller.descriptions import Value
from workshop.controller.memory import TestResult
from workshop.controller.server import advance, answer, disconnect, switched_on, tested
from workshop.controller.services.sessions import failed, finished
from workshop.controller.state import Instant, Request, ServerState
from workshop.controller.table import DiagnosticTable

SEED = bytes(range(1, 17))
PARKED: dict[str, Value] = {
    "vehicle_speed_m_s": 0.0, "engine_speed_rad_s": 85.0, "sump_temperature_k": 353.15, "pedal_ratio": 0.0,
    "current_gear": 0.0, "brake_pressure_pa": 1e6, "engine_run_time_s": 60.0, "revs_possible": 1.0,
    "clearing_possible": 1.0, "adaptation_possible": 1.0,
}  # fmt: skip


class Bench:
    def __init__(self, kept: ServerState | None = None, table: DiagnosticTable | None = None) -> None:
        self.table = table or full_table()
        self.t_s = 1000.0
        self.values = dict(PARKED)
        self.state = switched_on(self.table, kept, self.t_s)
        self.codes = {trouble.code: number for number, trouble in self.table.troubles.items()}

    def ask(self, request: str, *, to_all: bool = False, client: int = 0) -> str:
        """Return the response, empty if there is none."""
        moment = Instant(t_s=self.t_s, values=self.values, chance=SEED)
        asked = Request(payload=bytes.fromhex(request), is_functional=to_all, client=client)
        reply = answer(self.table, self.state, asked, moment)
        self.state = reply.state
        return (reply.payload or b"").hex(" ")

    def wait(self, duration_s: float) -> str:
        self.t_s += duration_s
        reply = advance(self.table, self.state, Instant(t_s=self.t_s, values=self.values))
        self.state = reply.state
        return (reply.payload or b"").hex(" ")

    def leave(self, client: int) -> None:
        self.state = disconnect(self.state, client)

    def monitor(self, code: str, result: TestResult) -> None:
        moment = Instant(t_s=self.t_s, values=self.values)
        self.state = tested(self.table, self.state, self.codes[code], result, moment)

    def finish(self, routine: int) -> None:
        self.state = finished(self.state, self.table, routine, Instant(t_s=self.t_s, values=self.values))

    def fail(self, routine: int) -> None:
        self.state = failed(self.state, routine)

    def unlock(self, level: int = 1) -> None:
        for session in ("03", "40")[: 1 + (level == 3)]:
            assert self.ask(f"10 {session}").startswith("50")
        lock = self.table.levels[level]
        key = int.from_bytes(SEED[: lock.seed_bytes], "big") ^ lock.key_mask
        assert self.ask(f"27 {level:02x}").startswith("67")
        assert self.ask(f"27 {level + 1:02x} {key.to_bytes(lock.seed_bytes, 'big').hex()}").startswith("67")
