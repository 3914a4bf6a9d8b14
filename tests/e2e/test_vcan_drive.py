"""The whole chain on a real vcan: emulator and service as processes, a broker, a candump, and a stranger on the bus."""

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from canlog.e2e.profile1 import COUNTER_PERIOD
from ecu_emulator.truth import TruthLog, read_truth
from fleet_contract import schema
from tests.plugins.broker import Mosquitto
from tests.plugins.vcan import own_vcan
from tests.support.bus_end import Stranger, candump, wait_for_shift
from tests.support.in_process import ended as run
from tests.support.service import Ended, Record, Service, service
from tests.support.starvation import is_starved, stalls, undisturbed, without_cut_parts
from tests.support.subscriber import Payload, Subscriber
from tests.uml.vcan import ip_link

SHIFT_COUNT = 6  # five up, one down
LOOK_S = 0.5
BEHIND_BYTES = 40_000  # of a log, behind the last of them: 1.5 s, which its estimate reads
EMULATOR = (sys.executable, "-m", "ecu_emulator")
LARGEST_ERROR = 4.0  # in stated standard deviations
UNTOLD_NS = (COUNTER_PERIOD - 1) * 10_000_000  # a sender so late looks as if a whole period of the counter were lost
NOT_THE_DRIVES = ("stream", "seq", "produced_at")

pytestmark = pytest.mark.vcan


@contextmanager
def emulator(folder: Path, vcan: str, *arguments: str | Path) -> Iterator[Service]:
    """Start an emulator on an interface."""
    with service(folder, "run", "-i", "socketcan", "-c", vcan, "--json", *arguments, program=EMULATOR) as running:
        yield running


@contextmanager
def listening(folder: Path, vcan: str, *arguments: str | Path, wrapper: tuple[str, ...] = ()) -> Iterator[Service]:
    """Start a service and wait until it hears the interface."""
    bus = ("run", "-i", "socketcan", "-c", vcan, "--json", "--store", folder / "car.sqlite")
    with service(folder, *bus, *arguments, wrapper=wrapper) as running:
        running.wait_for(lambda: "listening" in running.err)
        yield running


def accounted(frames: Record) -> int:
    """Return the frames whose fate the service tells."""
    dropped = int(frames["kernel_dropped"]) + int(frames["queue_dropped"])
    return int(frames["decoded"] + frames["ignored"] + frames["unsupported"]) + rejected(frames) + dropped


def rejected(frames: Record) -> int:
    return sum(frames["rejected"].values())


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveDrive:
    """A drive, heard by everyone."""

    emulated: Ended
    live: Ended
    replayed: Ended
    truth: TruthLog
    strangers: dict[str, int]
    shifts: list[Payload]
    clutches: list[Payload]
    statuses: list[Payload]
    stalls: list[tuple[int, int]]  # when the machine did not let the emulator send [ns]

    @property
    def longest_stall_ns(self) -> int:
        """The longest time for which the emulator did not send."""
        return max((after_ns - before_ns for before_ns, after_ns in self.stalls), default=0)

    @property
    def says_nothing(self) -> bool:
        """Whether the machine made so much late that the service rightly used no shift."""
        return bool(self.stalls) and all(shift["status"] == "rejected" or shift["reasons"] for shift in self.shifts)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> LiveDrive:
    """Return what a drive in real time left: about 25 s, again where the machine was too busy for all of it."""
    return undisturbed(lambda _: drive_live(tmp_path_factory.mktemp("live")), lambda found: found.says_nothing)


def shift_count(truth: Path) -> int:
    """Return how many shifts were driven; who looks often on a guest's one processor makes the sender late."""
    time.sleep(LOOK_S)
    return truth.read_bytes().count(b"from_gear") if truth.exists() else 0


def drive_live(folder: Path) -> LiveDrive:
    """Drive until some shifts were told, heard by everyone."""
    log, truth, data = folder / "bus.log", folder / "truth.jsonl", folder / "mosquitto"
    data.mkdir()
    broker = Mosquitto(data)
    broker.start()
    try:
        with (
            own_vcan() as vcan,
            Subscriber(broker.port) as backend,
            candump(vcan, log),
            listening(folder / "service", vcan, "--vehicle", "car1", "--broker", broker.url) as live,
        ):
            with (
                emulator(folder / "emulator", vcan, "--scenario", "case1", "--truth", truth) as driving,
                Stranger(vcan, 0.1) as stranger,
            ):
                live.wait_for(lambda: shift_count(truth) >= SHIFT_COUNT)
                told_bytes = log.stat().st_size
                live.wait_for(lambda: log.stat().st_size > told_bytes + BEHIND_BYTES)
                driving.send(signal.SIGTERM)
                emulated = driving.wait()
            live.send(signal.SIGTERM)
            ended = live.wait()
            backend.wait(lambda heard: heard.payloads("/status")[-1]["status"] == "offline")
        return LiveDrive(
            emulated=emulated,
            live=ended,
            replayed=run("analyze", log, "--json", "--vehicle", "car1"),
            truth=read_truth(truth),
            strangers=stranger.sent,
            shifts=backend.payloads("/shift"),
            clutches=[*backend.payloads("/clutch/1"), *backend.payloads("/clutch/2")],
            statuses=backend.payloads("/status"),
            stalls=stalls(log),
        )
    finally:
        broker.stop()


def test_both_programs_end_well(drive: LiveDrive) -> None:
    assert (drive.emulated.status, drive.live.status, drive.replayed.status) == (0, 0, 0)
    assert drive.emulated.records[0]["shifts"] == len(drive.truth.shifts) >= SHIFT_COUNT
    assert "warning" not in drive.live.err
    assert "error" not in drive.live.err


def test_every_frame_sent_is_accounted_for(drive: LiveDrive) -> None:
    report, frames = drive.emulated.records[0], drive.live.summary["frames"]
    assert report["frames_given_up"] == 0
    assert report["frames_sent"] > 10_000
    assert frames["on_bus"] == accounted(frames) == report["frames_sent"] + sum(drive.strangers.values())
    assert (frames["kernel_dropped"], frames["queue_dropped"]) == (0, 0)
    assert frames["missing"] == 0 or drive.longest_stall_ns > UNTOLD_NS
    assert frames["rejected"] == {kind: drive.strangers[kind] for kind in ("bad_crc", "short")}
    assert frames["decoded"] + frames["ignored"] == report["frames_sent"] + drive.strangers["ignored"]
    assert min(drive.strangers.values()) > (0 if drive.stalls else 50)


def test_a_candump_analysed_afterwards_says_the_same_to_the_bit(drive: LiveDrive) -> None:
    assert len(without_cut_parts(drive.live.shifts, drive.stalls)) >= SHIFT_COUNT
    assert [of_the_drive(shift) for shift in drive.replayed.shifts] == [of_the_drive(one) for one in drive.live.shifts]
    live, replayed = drive.live.summary, drive.replayed.summary
    assert [of_the_drive(clutch) for clutch in replayed["clutches"]] == [of_the_drive(one) for one in live["clutches"]]
    assert replayed["frames"] == live["frames"]


def of_the_drive(record: Record) -> Record:
    """Return what must not depend on who listened and when."""
    return {name: value for name, value in record.items() if name not in NOT_THE_DRIVES}


def test_what_a_subscriber_heard_lies_within_its_own_uncertainty_of_the_truth(drive: LiveDrive) -> None:
    assert [shift["seq"] for shift in drive.shifts] == list(range(1, len(drive.shifts) + 1))
    errors = []
    has_overrun = drive.emulated.records[0]["overruns"] > 0  # by the sender's own clock frames left late
    excuses = 0  # a shift whose frames came late may be left out, and two more until three agree that it was wrong
    shifts = without_cut_parts(drive.shifts, drive.stalls)
    if len(shifts) > len(drive.truth.shifts) and shifts[-1]["reasons"] == ["interrupted"]:
        shifts.pop()  # the emulator was stopped within it
    for shift, truth in zip(shifts, drive.truth.shifts, strict=True):
        told = (shift["from_gear"], shift["to_gear"], shift["clutch"])
        assert told == (truth.from_gear, truth.to_gear, truth.clutch)
        is_late = is_starved(shift, drive.stalls) or (has_overrun and shift["reasons"] == ["time_unsure"])
        excuses += 3 * is_late
        if is_late and shift["status"] == "rejected":
            assert (bool(shift["reasons"]), shift["friction"]) == (True, None)
            continue
        if excuses and shift["reasons"] == ["not_updated"]:
            assert shift["status"] == "valid"
            excuses -= 1
            continue
        assert (shift["status"], shift["reasons"]) == ("valid", [])
        friction = shift["friction"]
        errors.append((friction["mu_c"] - truth.mu_c) / friction["std_mu_c"])
        errors.append((friction["mu_s"] - truth.mu_s) / friction["std_mu_s"])
    assert errors or drive.says_nothing
    assert max(map(abs, errors), default=0.0) <= LARGEST_ERROR, errors


def test_what_a_subscriber_heard_is_what_the_schemas_describe(drive: LiveDrive) -> None:
    assert drive.shifts == drive.live.shifts
    assert [status["status"] for status in drive.statuses] == ["online", "offline"]
    for name, payloads in (("shift", drive.shifts), ("clutch", drive.clutches), ("status", drive.statuses)):
        assert payloads
        for payload in payloads:
            Draft202012Validator(schema(name)).validate(payload)


def test_frames_that_the_service_was_too_slow_for_are_counted_to_the_frame(vcan: str, tmp_path: Path) -> None:
    """Frozen for a second, with the receive buffer of a user without privileges, while a stranger floods the bus.

    In the end the emulator is stopped in the middle of a shift, which the service has open still when the interface is
    switched off under it: that costs no count either.
    """

    def attempt(number: int) -> Overload:
        assert ip_link("set", vcan, "up")
        return overload(tmp_path / str(number), vcan)

    found = undisturbed(attempt, lambda found: found.report["shifts"] > 1)  # it was stopped too late
    frames = found.ended.summary["frames"]
    assert not found.report["is_complete"]
    totals = found.truth.totals
    assert totals is not None
    assert (totals.frames, totals.shifts) == (found.report["frames_sent"], found.report["shifts"])
    assert frames["kernel_dropped"] > 500
    assert frames["on_bus"] == accounted(frames) == found.report["frames_sent"] + found.stranger.total
    assert 0 < rejected(frames) <= found.stranger.sent["bad_crc"] + found.stranger.sent["short"]
    hurt, *_, cut = found.ended.shifts  # a gap of more than a second cuts a shift in two, the second may be sound
    assert (hurt["from_gear"], hurt["status"], hurt["friction"]) == (1, "rejected", None)
    assert (cut["from_gear"], cut["status"], cut["reasons"]) == (2, "rejected", ["interrupted"])


@dataclass(frozen=True, slots=True, kw_only=True)
class Overload:
    """What came of a bus that was too much for a while."""

    report: Record
    truth: TruthLog
    ended: Ended
    stranger: Stranger


def overload(folder: Path, vcan: str) -> Overload:
    """Freeze a service for a second of a drive, flood the bus, switch it off in the end."""
    wrapper, truth = ("setpriv", "--bounding-set", "-net_admin", "--inh-caps", "-net_admin"), folder / "truth.jsonl"
    with listening(folder / "service", vcan, wrapper=wrapper) as live:
        with (
            emulator(folder / "emulator", vcan, "--scenario", "noise_only", "--truth", truth) as driving,
            Stranger(vcan, 0.01) as stranger,
        ):
            wait_for_shift(vcan, from_gear=1)
            live.send(signal.SIGSTOP)
            stranger.burst(3_000)
            time.sleep(1.0)
            live.send(signal.SIGCONT)
            wait_for_shift(vcan, from_gear=2)
            driving.send(signal.SIGTERM)
            emulated = driving.wait()
        assert ip_link("set", vcan, "down")
        live.wait_for(lambda: f"CAN interface '{vcan}' went down" in live.err)
        live.send(signal.SIGTERM)
        ended = live.wait()
    assert (emulated.status, ended.status) == (0, 0)
    assert "Traceback" not in ended.err
    return Overload(report=emulated.records[0], truth=read_truth(truth), ended=ended, stranger=stranger)
