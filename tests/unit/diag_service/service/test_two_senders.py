"""Two senders with the same identifiers are told by their counters, once for as long as it lasts."""

from dataclasses import replace

import pytest

from canlog.frames import FrameBatch, join
from diag_service.diagnosis.summary import FrameCounts
from diag_service.service.session import SenderWatch
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.scenario_file import load_scenario, parse_scenario
from tests.support.chain import diagnosed
from tests.support.traffic import as_received


def counts(decoded: int, wrong: int) -> FrameCounts:
    return FrameCounts(on_bus=decoded + wrong, decoded=decoded, rejected={"wrong_sequence": wrong})


def interleaved(*batches: FrameBatch) -> FrameBatch:
    """Return the frames of several senders in the order of their times."""
    frames = join(list(batches))
    order = frames.t_ns.argsort(kind="stable")
    return frames[order]


@pytest.mark.parametrize("delay_s", [0.0, 0.003, 0.05, 1.234])  # in step, or counting apart
def test_two_emulators_on_one_bus_are_told(delay_s: float) -> None:
    first, second = (as_received(frames_of(load_scenario(name))[0][:10_000]) for name in ("noise_only", "case2"))
    second = replace(second, t_ns=second.t_ns + round(delay_s * 1e9))
    text = SenderWatch().look(diagnosed([interleaved(first, second)]).counts)
    assert text is not None
    assert "two senders" in text


@pytest.mark.parametrize(
    "fault",
    [
        "",
        "[effects]\nframe_loss_ratio = 0.2\n",
        '[[bus_faults]]\nkind = "duplicate"\nshare = 0.1\n',
        '[[bus_faults]]\nkind = "restart"\nstart_s = 3\nduration_s = 1\n',
        '[[bus_faults]]\nkind = "bad_crc"\nshare = 0.5\n',
        '[[bus_faults]]\nkind = "silence"\nstart_s = 3\nduration_s = 5\n',
    ],
)
def test_one_sender_on_a_bad_bus_is_not(fault: str) -> None:
    frames, _ = frames_of(parse_scenario(f'name = "x"\n{fault}', "x"))
    assert SenderWatch().look(diagnosed([as_received(frames)]).counts) is None


def test_it_is_said_once_for_as_long_as_it_lasts_and_again_when_it_comes_back() -> None:
    watch = SenderWatch()
    seen = [(1_000, 0), (2_000, 800), (3_000, 1_600), (4_000, 1_600), (5_000, 2_400)]
    assert [watch.look(counts(*pair)) is not None for pair in seen] == [False, True, False, False, True]
