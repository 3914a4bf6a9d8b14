"""The life of P0897: fluid ages, is changed, and the code is forgotten again: ``python -m tests.tools.uds_ageing``.

Every operation cycle is a process, which copies of the car live through with a kill (-9) after each step: the next
start must find each code confirmed as it was before or as it is after. The friction in the snapshot is held against the
truth. Status 1: something is not so. Takes some minutes.
"""

import argparse
import json
import math
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.iso14229 import Status
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.log_formats.record import open_log
from tests.support.uds.ageing_car import WORN, Plan

VEHICLE: Final = "car1"
FIRST_DAY: Final = datetime(2026, 1, 1, tzinfo=UTC)
MOST_STD: Final = 2.0
MOST_CYCLES: Final = 60
AGE_CYCLES: Final = 40
AGED_CYCLES: Final = 4  # that are driven with aged fluid
FRICTION: Final = {1: 0x0300, 2: 0x0301}
_STEP: Final = 1e-5  # of a coefficient on the wire
_NOT_AVAILABLE: Final = 0xFFFF
_KILLED: Final = -9
_NS_PER_S: Final = 1_000_000_000

Steps = list[dict[str, Any]]


@dataclass
class Life:
    """A car whose every day is an operation cycle."""

    folder: Path
    vehicle_seed: int
    ageing_cycles: int
    day: int = 0
    kills: int = 0
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.home.mkdir()

    @property
    def home(self) -> Path:
        return self.folder / "home"

    def plan(self, fluid: str, *, cycles: int = 1, is_new_fluid: bool = False) -> Plan:
        """Return the next day's plan."""
        self.day += 1
        start = FIRST_DAY + timedelta(days=self.day)
        return Plan(
            folder=str(self.home),
            fluid=fluid,
            vehicle_seed=self.vehicle_seed,
            ageing_cycles=self.ageing_cycles,
            drive_seed=self.day,
            cycles=cycles,
            start_ns=int(start.timestamp()) * _NS_PER_S,
            new_fluid_at=(start + timedelta(hours=1)).isoformat() if is_new_fluid else "",
        )

    def estimated(self, plan: Plan) -> Plan:
        """Let the service analyse a log of the drive with what it keeps; return the plan with what it says."""
        log, lines = self.folder / f"{self.day}.blf", self.folder / f"{self.day}.jsonl"
        with open_log(log, start_ns=plan.start_ns) as file:
            file.write(frames_of(plan.scenario)[0])
        words = ["analyze", str(log), "--store", str(plan.store), "--vehicle", VEHICLE, "--json"]
        done = subprocess.run([sys.executable, "-m", "diag_service", *words], check=True, stdout=subprocess.PIPE)
        lines.write_bytes(done.stdout)
        log.unlink()
        return replace(plan, lines=str(lines))

    def live(self, plan: Plan, *, is_killed: bool = True) -> Steps:
        """Let a day happen; before, in copies of the car, let it end after each of its steps."""
        before = self._copied(self.home, "before")
        steps = self._run(plan, 0)
        allowed = (self.confirmed(before), self.confirmed(self.home))
        for count in range(1, len(steps) + 1 if is_killed else 1):
            folder = self._copied(before, "killed")
            self._run(replace(plan, folder=str(folder)), count)
            self.kills += 1
            found = self.confirmed(folder)
            if not is_possible(found, *allowed):
                self.wrong.append(f"day {self.day}, killed after step {count}: {found}, between {allowed}")
        return steps

    def _copied(self, folder: Path, name: str) -> Path:
        there = self.folder / name
        shutil.rmtree(there, ignore_errors=True)
        shutil.copytree(folder, there)
        return there

    def _run(self, plan: Plan, kill_after: int) -> Steps:
        file = self.folder / "plan.json"
        file.write_text(json.dumps(asdict(replace(plan, kill_after=kill_after))), encoding="utf-8")
        words = [sys.executable, "-m", "tests.support.uds.ageing_car", str(file)]
        done = subprocess.run(words, check=False, stdout=subprocess.PIPE, text=True)
        if done.returncode != (_KILLED if kill_after else 0):
            raise RuntimeError(f"the car ended with {done.returncode}, plan {plan}")
        return [json.loads(line) for line in done.stdout.splitlines()]

    def confirmed(self, folder: Path) -> list[str]:
        """Return the codes that the next start finds confirmed."""
        with self.started(folder) as controller:
            records, troubles = controller.state.memory.records, controller.table.troubles
            return [troubles[number].code for number, one in records.items() if one.status & Status.CONFIRMED]

    def started(self, folder: Path) -> "Started":
        """Return a controller as the next start would find it; the car's own memory stays as it is."""
        return Started(self._copied(folder, "looked") / "tcu.json")


class Started:
    """A controller that has just started, while this is entered."""

    def __init__(self, path: Path) -> None:
        self._file = MemoryFile(path, shipped_table())

    def __enter__(self) -> Controller:
        store = self._file.__enter__()
        return Controller(shipped_table(), values=dict, clock=lambda: 0.0, chance=bytes, store=store)

    def __exit__(self, *_: object) -> None:
        self._file.__exit__(None, None, None)


def is_possible(found: Sequence[str], before: Sequence[str], after: Sequence[str]) -> bool:
    """Return whether each code is as it was before, or as it is after."""
    return set(before) & set(after) <= set(found) <= set(before) | set(after)


def snapshot_of(controller: Controller) -> dict[int, bytes]:
    """Return the data of the first snapshot of P0897, as a tester reads them."""
    response = controller.ask(b"\x19\x04" + WORN.to_bytes(3, "big") + b"\x01") or b""
    found: dict[int, bytes] = {}
    rest = response[8:]
    while rest:
        number = int.from_bytes(rest[:2], "big")
        size = controller.table.data[number].size_bytes
        found[number], rest = rest[2 : 2 + size], rest[2 + size :]
    return found


def deviations(snapshot: dict[int, bytes], truth: dict[str, list[float]]) -> Iterator[tuple[str, float, float, float]]:
    """Yield name, value, stated deviation and truth of each coefficient in a snapshot."""
    for clutch, number in FRICTION.items():
        raws = [int.from_bytes(snapshot[number][place : place + 2], "big") for place in range(0, 8, 2)]
        numbers = [math.nan if raw == _NOT_AVAILABLE else raw * _STEP for raw in raws]
        for place, name in enumerate(("mu_C", "mu_S")):
            yield f"{name} of clutch {clutch}", numbers[2 * place], numbers[2 * place + 1], truth[str(clutch)][place]


def shown(what: str, steps: Steps, life: Life) -> None:
    statuses = " ".join(f"{status:02X}" for status in dict.fromkeys(step["worn"] for step in steps))
    confirmed = ", ".join(life.confirmed(life.home)) or "none"
    print(f"{what:<44} P0897 {statuses:<12} next start: {confirmed:<14} {life.kills} kills", flush=True)


def is_near(life: Life, steps: Steps) -> bool:
    """Print the friction in the snapshot beside the truth when the test failed; return whether it fits."""
    failed = next((step for step in steps if step["worn"] & Status.TEST_FAILED), None)
    if failed is None:
        print("    the test of the fluid has not failed")
        return False
    with life.started(life.home) as controller:
        rows = list(deviations(snapshot_of(controller), failed["truth"]))
    for name, value, std, truth in rows:
        print(f"    {name:<16} {value:.5f} +- {std:.5f}, truth {truth:.5f}: {(value - truth) / std:+.2f} deviations")
    return all(abs(value - truth) <= MOST_STD * std for _, value, std, truth in rows)


def lived(life: Life) -> Iterator[tuple[str, bool]]:
    """Live through it all; yield what was expected, and whether it was so."""
    steps = life.live(life.estimated(life.plan("ideal")))
    shown("new fluid", steps, life)
    yield "new fluid passes the test", not steps[-1]["worn"] & (Status.PENDING | Status.NOT_TESTED_THIS_CYCLE)

    steps = life.live(life.estimated(life.plan("ageing", cycles=life.ageing_cycles + AGED_CYCLES)))
    shown(f"fluid that ages in {life.ageing_cycles} shift cycles", steps, life)
    pending = steps[-1]["worn"] & (Status.PENDING | Status.CONFIRMED)
    yield "aged fluid is pending", pending == Status.PENDING
    yield f"the snapshot's friction is within {MOST_STD:g} deviations of the truth", is_near(life, steps)

    steps = life.live(life.estimated(life.plan("case2")))
    shown("aged fluid once more", steps, life)
    yield "then it is confirmed", bool(steps[-1]["worn"] & Status.CONFIRMED)

    steps = life.live(life.plan("case2", is_new_fluid=True))
    shown("31 01 03 03 in the workshop", steps, life)
    yield "clearing says that nothing is known", bool(steps[-1]["not_learned"] & Status.TEST_FAILED)

    plan = life.estimated(life.plan("ideal"))
    steps = life.live(plan)
    shown("new fluid again", steps, life)
    healed = steps[-1]["worn"] & (Status.TEST_FAILED | Status.CONFIRMED)
    yield "new fluid heals, and the code stays confirmed", healed == Status.CONFIRMED
    yield "both clutches are known again", not steps[-1]["not_learned"] & Status.TEST_FAILED

    count = 1
    while "P0897" in life.confirmed(life.home) and count < MOST_CYCLES:
        count += 1
        steps = life.live(plan, is_killed=count in {2, AGE_CYCLES})
    shown(f"forgotten after {count} good warm cycles", steps, life)
    yield f"it is forgotten after {AGE_CYCLES} cycles", count == AGE_CYCLES
    yield "no kill lost a confirmed code or invented one", not life.wrong


def show_snapshots(seeds: Iterable[int], ageing_cycles: int) -> None:
    """Print the friction in the snapshots of several vehicles beside the truth."""
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            life = Life(Path(folder), seed, ageing_cycles)
            life.live(life.estimated(life.plan("ideal")), is_killed=False)
            steps = life.live(
                life.estimated(life.plan("ageing", cycles=life.ageing_cycles + AGED_CYCLES)), is_killed=False
            )
            print(f"vehicle {seed}: {'yes' if is_near(life, steps) else 'NO'}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=20, help="in which fluid becomes as bad as it gets")
    parser.add_argument("--seed", type=int, default=1, help="of the vehicle")
    parser.add_argument("--snapshots", type=int, metavar="N", help="of so many vehicles, and nothing else")
    options = parser.parse_args()
    if options.snapshots is not None:
        show_snapshots(range(options.seed, options.seed + options.snapshots), options.cycles)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        life = Life(Path(folder), options.seed, options.cycles)
        found = list(lived(life))
        print("".join(f"  {told}\n" for told in life.wrong), end="")
    for what, is_so in found:
        print(f"{'yes' if is_so else 'NO ':<4}{what}")
    return int(not all(is_so for _, is_so in found))


if __name__ == "__main__":
    sys.exit(main())
