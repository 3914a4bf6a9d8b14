"""What emulator and service do in a SIL Kit simulation when another participant ends, crashes, hangs or joins late.

``python -m tests.tools.silkit_partners [--runs 10] [NAME...]`` plays each story so often, with participants of SIL
Kit's own binding, and prints a table; status 1 if a run hangs, or a status, a word or the time of an answer is wrong.
"""

import argparse
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Final

from tests.plugins.silkit import ROOT, Simulations

BUS: Final = ("-i", "silkit", "-c", "CAN1")
PARTNER: Final = str(ROOT / "can_silkit" / "tests" / "partner.py")
HANG_S: Final = 150.0  # of a run of the tool; a test has its own
PATIENCE_S: Final = 60.0  # longer than the emulator prepares its first step on a busy machine
NAMED_S: Final = 10.0
P2_MS: Final = 50.0
ENDED, CRASHED = "the simulation has ended", "partner crashed: it left without a word"
HANGS, COMPLETE = "partner is stuck or busy in a step", "complete: "
LONG, SHORT = ("--cycles", "500"), ("--cycles", "6")


@dataclass(frozen=True, slots=True, kw_only=True)
class Story:
    """What a partner does, and how the programs are to end.

    Attributes
    ----------
    partner
        What its command line says.
    is_late
        Whether nobody expects it and it joins when others have begun.
    status
        Of emulator and service.
    emulator_says, service_says
        Words of what they say.
    has_end
        Whether the partner comes to an end of its own.
    is_sent_away
        Whether it is killed once it was named: SIL Kit lets nobody join late who waits for a system controller.
    """

    partner: tuple[str, ...]
    is_late: bool = False
    drive: tuple[str, ...] = LONG
    service: tuple[str, ...] = ("--once",)
    status: int = 0
    emulator_says: str = ENDED
    service_says: str = ENDED
    has_end: bool = True
    is_sent_away: bool = False


STORIES: Final[Mapping[str, Story]] = {
    "ends": Story(partner=("--until", "30")),
    "crashes": Story(
        partner=("--until", "30", "--then", "crash"), status=3, emulator_says=CRASHED, service_says=CRASHED
    ),
    "hangs": Story(
        partner=("--until", "30", "--then", "hang"), status=3, emulator_says=HANGS, service_says=HANGS, has_end=False
    ),
    "asks": Story(partner=("--until", "9", "--ask"), drive=(*LONG, "--diagnostics")),
    "late, ends": Story(
        partner=("--autonomous", "--until", "150"), is_late=True, drive=SHORT, emulator_says=COMPLETE
    ),
    "late, stays": Story(
        partner=("--autonomous", "--until", "500"), is_late=True, drive=SHORT, service=(), emulator_says=COMPLETE
    ),
    "late, crashes": Story(
        partner=("--autonomous", "--until", "150", "--then", "crash"), is_late=True, drive=SHORT, emulator_says=COMPLETE
    ),
    "late, hangs": Story(
        partner=("--autonomous", "--until", "30", "--then", "hang"), is_late=True, status=3, emulator_says=HANGS,
        service_says=HANGS, has_end=False,
    ),
    "late, coordinated": Story(
        partner=(), is_late=True, drive=SHORT, emulator_says=COMPLETE, has_end=False, is_sent_away=True
    ),
}  # fmt: skip


class Program:
    """A program whose words are kept, with the time at which they came."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process
        self._lines: list[tuple[float, str]] = []
        self._readers = [
            threading.Thread(target=self._read, args=(stream,), daemon=True)
            for stream in (process.stdout, process.stderr)
        ]
        for reader in self._readers:
            reader.start()

    def _read(self, stream: IO[str]) -> None:
        for line in stream:
            self._lines.append((time.monotonic(), line))

    @property
    def said(self) -> str:
        return "".join(line for _, line in self._lines)

    def said_s(self, word: str) -> float | None:
        """Return when a line with this word came."""
        return next((t_s for t_s, line in list(self._lines) if word in line), None)

    def wait_until(self, word: str, hang_s: float) -> None:
        """Wait until it has said this, it ends, or hangs."""
        deadline_s = time.monotonic() + hang_s
        while self.said_s(word) is None and self.process.poll() is None and time.monotonic() < deadline_s:
            time.sleep(0.02)

    def status(self, hang_s: float) -> int | None:
        """Return the exit status; None: it hangs."""
        try:
            status = self.process.wait(hang_s)
        except subprocess.TimeoutExpired:
            return None
        for reader in self._readers:
            reader.join(hang_s)
        return status


@dataclass(slots=True)
class Outcome:
    """How a run went; nothing is wrong if ``faults`` is empty."""

    faults: list[str] = field(default_factory=list)
    named_s: float | None = None  # from what the partner did to the first word on it
    longest_wait_ms: float | None = None

    def expect(self, what: str, *, is_so: bool) -> None:
        if not is_so:
            self.faults.append(what)


def play(story: Story, simulations: Simulations, *, hang_s: float = HANG_S) -> Outcome:
    """Play a story once, and return how it went."""
    outcome = Outcome()
    simulations.begin("ecu-emulator", "diag-service", "bench", *(() if story.is_late else ("partner",)))

    def start(name: str, *words: str) -> Program:
        return Program(simulations.start("python", PARTNER, simulations.uri, name, *words))

    patience_s = PATIENCE_S if "hang" in story.partner else hang_s
    emulator = Program(
        simulations.start("ecu-emulator", "run", *BUS, "--scenario", "noise_only", *story.drive, patience_s=patience_s)
    )
    service = Program(
        simulations.start("diag-service", "monitor", *BUS, *story.service, step_s=0.01, patience_s=patience_s)
    )
    bench = start("bench", "--step-ms", "10")
    if story.is_late:
        bench.wait_until("has begun", hang_s)
    partner = start("partner", *story.partner)
    if story.is_sent_away:
        emulator.wait_until("partner reports an error", hang_s)
        partner.process.kill()
    statuses = {"emulator": emulator.status(hang_s)}
    if not story.service:  # it waits for another simulation, and must not hold up who goes on in this one
        statuses["partner"] = partner.status(hang_s)
        service.process.send_signal(signal.SIGINT)
    statuses["service"] = service.status(hang_s)
    if not story.has_end:
        partner.process.kill()
    for name, program in (("bench", bench), ("partner", partner)):
        if program.status(hang_s) is None:
            outcome.faults.append(f"{name} hangs")
    for name, status in statuses.items():
        expected = 0 if name == "partner" else story.status
        outcome.expect(f"{name}: status {status} instead of {expected}", is_so=status == expected)
    for name, program, words in (
        ("emulator", emulator, story.emulator_says),
        ("service", service, story.service_says),
    ):
        said = program.said.strip().splitlines()
        outcome.expect(f"the {name} says {said[-1:]} in place of {words!r}", is_so=words in program.said)
    _judge_partner(story, partner, emulator, outcome)
    return outcome


def _judge_partner(story: Story, partner: Program, emulator: Program, outcome: Outcome) -> None:
    did_s, named_s = partner.said_s(" now"), emulator.said_s("partner ")
    if did_s is not None:
        outcome.expect("nobody names the partner", is_so=named_s is not None)
        outcome.named_s = None if named_s is None else max(0.0, named_s - did_s)
    if "--ask" in story.partner:
        seen = json.loads(partner.said.splitlines()[-1])
        outcome.longest_wait_ms = float(seen["longest_wait_ms"])
        outcome.expect(f"{seen['asked']} questions", is_so=seen["asked"] >= 70)
        outcome.expect(f"an answer after {outcome.longest_wait_ms} ms", is_so=outcome.longest_wait_ms <= P2_MS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Play the stories and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of: {', '.join(STORIES)}")
    options = parser.parse_args(arguments)
    names = options.names or list(STORIES)
    print(f"{'a partner that':<20} {'right':>8}  {'named after [s]':>16}  {'longest answer [ms]':>20}  wrong")
    has_failed = False
    for name in names:
        outcomes = []
        for _ in range(options.runs):
            with TemporaryDirectory() as folder, ExitStack() as stack:
                simulations = Simulations(Path(folder), stack)
                simulations.start_registry()
                outcomes.append(play(STORIES[name], simulations))
        faults = sorted({fault for outcome in outcomes for fault in outcome.faults})
        named_s = [outcome.named_s for outcome in outcomes if outcome.named_s is not None]
        if max(named_s, default=0.0) > NAMED_S:
            faults.append(f"named after {max(named_s):.1f} s")
        waits_ms = [outcome.longest_wait_ms for outcome in outcomes if outcome.longest_wait_ms is not None]
        right = sum(not outcome.faults for outcome in outcomes)
        print(
            f"{name:<20} {f'{right} of {len(outcomes)}':>8}  {f'{max(named_s):.1f}' if named_s else '-':>16}  "
            f"{f'{max(waits_ms):g}' if waits_ms else '-':>20}  {'; '.join(faults) or '-'}",
            flush=True,
        )
        has_failed |= bool(faults)
    return int(has_failed)


if __name__ == "__main__":
    sys.exit(main())
