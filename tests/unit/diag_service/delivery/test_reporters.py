"""What people and the next program in a pipe get to see."""

from dataclasses import replace

from clutch_results.records import Reason, ShiftResult, ShiftStatistics
from diag_service.delivery import MemoryReporter, News, PipeReporter
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.summary import Summary
from tests.support.builders import rejected, shift_result

FRAMES = FrameCounts(
    on_bus=100,
    decoded=70,
    ignored=10,
    kernel_dropped=3,
    queue_dropped=4,
    rejected={"bad_crc": 12, "repeated": 0, "short": 1},
    missing=5,
)


def interrupted(seq: int) -> ShiftResult:
    result = rejected(shift_result(seq, to_gear=3))
    return replace(result, estimate=replace(result.estimate, reasons=(Reason.INTERRUPTED,)))


def numbers() -> Summary:
    statistics = ShiftStatistics()
    statistics = statistics.with_shift(shift_result(1), is_new=True)
    statistics = statistics.with_shift(shift_result(2), is_new=False)
    statistics = statistics.with_shift(interrupted(3), is_new=True)
    return Summary(vehicle="car1", frames=FRAMES, shifts=statistics, unpublished_count=2)


def test_a_broken_pipe_is_told_once_and_then_nothing_is_written() -> None:
    class Broken(MemoryReporter):
        def report(self, news: News) -> None:
            super().report(news)
            if isinstance(news, ShiftResult):
                raise BrokenPipeError

    broken, breaks = Broken(), list[str]()
    reporter = PipeReporter(broken, lambda: breaks.append("broken"))
    reporter.report("vcan0")
    reporter.report(shift_result(1))
    reporter.report(shift_result(2))
    reporter.report(numbers())
    assert breaks == ["broken"]
    assert [result.seq for result in broken.results] == [1]
    assert broken.summaries == []
