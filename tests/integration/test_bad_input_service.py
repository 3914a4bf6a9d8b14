"""What users and their machines do wrong, at the service as a process: one clear line and the right exit status."""

import signal
import time
from pathlib import Path

import can
import pytest

from ecu_emulator.cli import main as emulator
from tests.plugins.broker import Mosquitto
from tests.plugins.drives import SHIFT_COUNT
from tests.support.in_process import ended as run
from tests.support.service import service
from tests.support.subscriber import Subscriber

NOMINAL = Path(__file__).parents[2] / "clutch_model" / "calibrations" / "nominal.toml"
FOREIGN_DBC = """VERSION ""

NS_ :

BS_:

BU_: Radio Wiper

BO_ 256 RadioState: 8 Radio
 SG_ Volume : 0|8@1+ (1,0) [0|100] "%" Wiper
 SG_ Station : 8|16@1+ (0.05,0) [0|3276.75] "MHz" Wiper

BO_ 257 WiperState: 2 Wiper
 SG_ Speed : 0|4@1+ (1,0) [0|15] "" Radio
"""


@pytest.mark.parametrize("command", ["run", "analyze"])
@pytest.mark.parametrize(
    ("arguments", "texts"),
    [
        (("--dbc", "{tmp}/none.dbc"), ("none.dbc", "No such file")),
        (("--dbc", "{tmp}/foreign.dbc"), ("no shipped profile fits the database", "no message ECM_TorqueSpeed")),
        (("--calibration", "{tmp}/unknown.toml"), ("unknown", "colour")),
    ],
    ids=["DBC missing", "DBC foreign", "calibration with an unknown key"],
)
def test_a_description_of_another_vehicle(
    drive_log: Path, tmp_path: Path, command: str, arguments: tuple[str, str], texts: tuple[str, str]
) -> None:
    (tmp_path / "foreign.dbc").write_text(FOREIGN_DBC, encoding="ascii")
    (tmp_path / "unknown.toml").write_text('colour = "red"\n' + NOMINAL.read_text(encoding="utf-8"), encoding="utf-8")
    filled = [argument.format(tmp=tmp_path) for argument in arguments]
    what = ("-i", "virtual", "-c", "any") if command == "run" else (drive_log,)
    store = tmp_path / "car.sqlite"
    ended = run(command, *what, *filled, "--store", store)
    for text in texts:
        ended.assert_one_line(2, text)
    assert not store.exists()


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".mf4"])
def test_a_log_that_ends_too_early(tmp_path: Path, suffix: str) -> None:
    """What came before the cut counts, and the cut is told; an MF4 file without its end is none."""
    log, cut = tmp_path / f"drive{suffix}", tmp_path / f"cut{suffix}"
    recorded = tmp_path / "drive.log" if suffix == ".asc" else log
    assert emulator(["record", str(recorded), "--scenario", "noise_only"]) == 0
    if recorded != log:
        with can.LogReader(recorded) as reader, can.ASCWriter(log) as writer:
            for message in reader:
                writer.on_message_received(message)
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 3 // 10])
    ended = run("analyze", cut, "--json")
    if suffix == ".mf4":
        ended.assert_one_line(3, "damaged or cut off")
        return
    assert ended.status == 5
    assert f"diag-service: warning: {cut}: the log is cut off\n" in ended.err
    assert "Traceback" not in ended.err
    assert ended.summary["frames"]["unreadable"] == {"cut_off": 1}
    assert {shift["status"] for shift in ended.shifts[:2]} == {"valid"}


@pytest.mark.broker
def test_a_broker_that_refuses_gets_its_results_once_it_lets_us_in(drive_log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    broker = Mosquitto(folder, users={"backend": "heard", "car1": "driven"})
    broker.start()
    arguments = ("analyze", drive_log, "--json", "--vehicle", "car1", "--store", tmp_path / "car.sqlite", "--broker")
    try:
        refused = run(*arguments, broker.url.replace("//", "//car1:wrong@"))
        assert (refused.status, refused.err.count("\n")) == (0, 1)
        assert refused.err.startswith(f"diag-service: warning: broker 127.0.0.1:{broker.port}: connection refused: ")
        assert "wrong" not in refused.err
        assert len(refused.shifts) == SHIFT_COUNT
        assert refused.summary["shifts"]["unpublished"] == SHIFT_COUNT
        with Subscriber(broker.port, "backend", "heard") as backend:
            trusted = run(*arguments, broker.url.replace("//", "//car1:driven@"))
            backend.wait(lambda heard: len(heard.payloads("car1/shift")) == SHIFT_COUNT)
            assert backend.payloads("car1/shift") == refused.shifts
    finally:
        broker.stop()
    assert (trusted.status, trusted.summary["shifts"]["unpublished"]) == (0, 0)


def test_an_analysis_stopped_at_any_moment_ends_well_and_is_taken_up(cycle_log: Path, tmp_path: Path) -> None:
    arguments = ("analyze", cycle_log, "--json", "--store", tmp_path / "car.sqlite")
    stopped, statuses = [], []
    for number, delay_s in ((signal.SIGINT, 0.0), (signal.SIGTERM, 0.8)):
        with service(tmp_path / f"{delay_s}", *arguments) as running:
            running.wait_until_it_catches(signal.SIGUSR1)  # the last to get a handler
            time.sleep(delay_s)
            running.send(number)
            ended = running.wait()
            stopped.append(ended)
            statuses.append(0 if ended.summary["complete"] else 128 + number)
    whole = run(*arguments)
    assert [ended.status for ended in (*stopped, whole)] == [*statuses, 0]
    assert statuses[0] == 130
    assert all(ended.err.count("\n") == (not ended.summary["complete"]) for ended in (*stopped, whole))
    for ended in stopped:
        assert ended.shifts == whole.shifts[: len(ended.shifts)]
        assert ended.summary["schema"] == "clutchdiag/summary/v1"
    assert len(stopped[0].shifts) < len(whole.shifts) == 10
