"""A diagnosis in a thread of its own: who waits for shifts is told of all of them."""

import asyncio
import threading
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Self, cast

from diag_service.api.live import BackgroundDiagnosis
from diag_service.diagnosis.records import ShiftResult
from tests.support.builders import shift_result
from tests.support.patience import HANG_S

if TYPE_CHECKING:
    from diag_service.api.live import LiveDiagnosis


class EndingDiagnosis:
    """Finds a shift and ends while somebody looks at what there is."""

    def __init__(self) -> None:
        self._found: list[ShiftResult] = []
        self._is_looked_at = threading.Event()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self._found.append(shift_result(1))

    async def __aiter__(self) -> AsyncIterator[ShiftResult]:
        await asyncio.to_thread(self._is_looked_at.wait)
        for one in self._found:
            yield one

    @property
    def results(self) -> list[ShiftResult]:
        seen = self._found[:]
        self._is_looked_at.set()
        for thread in threading.enumerate():
            if thread.name == "live diagnosis":
                thread.join()
        return seen

    def stop(self) -> None:
        self._is_looked_at.set()


def test_a_shift_that_comes_with_the_end_is_there() -> None:
    with BackgroundDiagnosis(cast("LiveDiagnosis", EndingDiagnosis())) as heard:
        assert heard.wait_for(1, HANG_S) == (shift_result(1),)
