"""Fixtures of a test bench: a diagnosis that listens to its bus (docs/python.md). Nothing is loaded until it is used.

The bus comes from the fixtures of ``ecu_emulator.pytest_plugin``; the two meet on it.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from canlog.live.medium import Medium
    from diag_service.api.live import BackgroundDiagnosis


@pytest.fixture
def diagnosis(
    request: pytest.FixtureRequest, make_vcan_bus: Callable[[], "Medium"]
) -> Iterator[Callable[..., "BackgroundDiagnosis"]]:
    """Return a function that begins to diagnose a bus; when it returns, the bus is listened to. It stops with the test.

    ``diagnosis(bus=another, dbc="car.dbc")``: ``bus`` is one of ``make_vcan_bus``, by default ``vcan_bus``; the other
    arguments are those of ``diag_service.diagnose``.
    """
    del make_vcan_bus  # it must outlive the diagnosis
    with ExitStack() as stack:

        def start(bus: "Medium | None" = None, **options: Any) -> "BackgroundDiagnosis":  # noqa: ANN401 - diagnose's
            from diag_service.api.live import diagnose  # noqa: PLC0415 - not before it is used

            medium = request.getfixturevalue("vcan_bus") if bus is None else bus
            if medium.interface == "socketcan":
                live = diagnose(interface=medium.interface, channel=medium.channel, **options)
            else:
                end = medium.open()
                stack.callback(end.shutdown)
                live = diagnose(end, **options)
            return stack.enter_context(live.in_background())

        yield start
