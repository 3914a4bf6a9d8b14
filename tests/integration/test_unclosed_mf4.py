"""An MF4 file that its writer did not close is no evidence that anything is missing: loggers leave every file so."""

from pathlib import Path

import pytest

from canlog.frames import join
from canlog.logs import read_log
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats import open_log
from tests.support.in_process import ended
from tests.support.mf4_layouts import Layout, laid_out
from tests.support.traffic import START_NS

asammdf = pytest.importorskip("asammdf")


@pytest.fixture(scope="module")
def unclosed(cycle_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a drive as a logger leaves it that is switched off with the car."""
    folder = tmp_path_factory.mktemp("mf4")
    frames = join(list(read_log(cycle_log)))
    with open_log(folder / "drive.mf4", start_ns=START_NS) as log:
        t_s = (frames.t_ns - frames.t_ns[0]) / 1e9
        log.write(EncodedFrames(t_s=t_s, can_id=frames.can_id, length=frames.length, data=frames.data))
    with asammdf.MDF(folder / "drive.mf4") as mdf:
        mdf.save(folder / "plain.mf4", compression=0)
    path = folder / "unclosed.mf4"
    path.write_bytes(laid_out(folder / "plain.mf4", Layout.PLAIN, is_sorted=True, is_finished=False).contents)
    return path


def test_a_log_that_was_not_closed_gets_its_verdict(unclosed: Path) -> None:
    told = ended("analyze", unclosed, "--json", "--strict")
    assert told.status == 0, told.err
    assert f"{unclosed}: the recorder did not close the log" in told.err
    assert (told.summary["complete"], told.summary["incomplete"]) == (True, [])
    assert "good" in {clutch["condition"] for clutch in told.summary["clutches"]}
