"""Fixtures of a test bench: buses, an emulated vehicle on them, the frames that pass (docs/python.md).

Nothing is loaded until a fixture is used.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from canlog.live.medium import Medium
    from canlog.live.pythoncan import FrameRecorder
    from ecu_emulator.api import Emulator

AUTO = "auto"
OPTION = "vcan_bus"
_EXPLANATIONS = pytest.StashKey[dict[str, list[str]]]()  # kind of bus -> explanations


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let the kind of bus be chosen."""
    words = [AUTO, "socketcan", "udp_multicast", "virtual"]
    text = "bus of the clutchdiag fixtures: a vcan interface if there is one, else multicast UDP (auto), or this one"
    parser.getgroup("clutchdiag").addoption("--vcan-bus", choices=words, default=None, help=text)
    parser.addini(OPTION, f"{text}: {', '.join(words)}", default=AUTO)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say on which buses the tests ran."""
    for texts in config.stash.get(_EXPLANATIONS, {}).values():
        more = f" (and {len(texts) - 1} more like it)" if len(texts) > 1 else ""
        terminalreporter.write_line(f"vcan_bus: {texts[0]}{more}")


@pytest.fixture
def make_vcan_bus(request: pytest.FixtureRequest) -> Iterator[Callable[[], "Medium"]]:
    """Return a function that gives another bus with each call; all of them end with the test.

    A bus is a ``canlog.live.medium.Medium``: ``.open()`` is an end of it, ``.can_options`` what ``can.Bus`` is given in
    another process, ``.explanation`` says which bus it is and why.
    """
    kind = request.config.getoption("--vcan-bus") or request.config.getini(OPTION)
    explanations = request.config.stash.setdefault(_EXPLANATIONS, {})
    with ExitStack() as stack:

        def make() -> "Medium":
            medium = stack.enter_context(_buses()[kind]())
            explanations.setdefault(medium.interface, []).append(medium.explanation)
            return medium

        yield make


@pytest.fixture
def vcan_bus(make_vcan_bus: Callable[[], "Medium"]) -> "Medium":
    """Return the bus of this test, on which ``emulated_vehicle`` and ``diagnosis`` meet unless told otherwise."""
    return make_vcan_bus()


@pytest.fixture
def emulated_vehicle(
    request: pytest.FixtureRequest, make_vcan_bus: Callable[[], "Medium"]
) -> Iterator[Callable[..., "Emulator"]]:
    """Return a function that starts an ``ecu_emulator.Emulator`` and returns it; it stops with the test.

    ``emulated_vehicle("case2", faults=[...], bus=another, seed=7)``: arguments are those of ``Emulator``; ``bus`` is
    one of ``make_vcan_bus``, by default ``vcan_bus``.
    """
    del make_vcan_bus  # it must outlive the vehicle
    with ExitStack() as stack:

        def start(scenario: Any = "ideal", *, bus: "Medium | None" = None, **options: Any) -> "Emulator":  # noqa: ANN401
            from ecu_emulator.api import Emulator  # noqa: PLC0415 - not before it is used

            medium = request.getfixturevalue("vcan_bus") if bus is None else bus
            car = Emulator(
                scenario, interface=medium.interface, channel=medium.channel, options=medium.options, **options
            )
            return stack.enter_context(car)

        yield start


@pytest.fixture
def recorded_frames(
    request: pytest.FixtureRequest, make_vcan_bus: Callable[[], "Medium"]
) -> Iterator[Callable[..., "FrameRecorder"]]:
    """Return a function that begins to record a bus, by default ``vcan_bus``, and returns its ``FrameRecorder``."""
    del make_vcan_bus  # it must outlive the recorder
    with ExitStack() as stack:

        def start(bus: "Medium | None" = None) -> "FrameRecorder":
            from canlog.live.pythoncan import FrameRecorder  # noqa: PLC0415 - not before it is used

            medium = request.getfixturevalue("vcan_bus") if bus is None else bus
            return stack.enter_context(FrameRecorder(stack.enter_context(medium.open())))

        yield start


def _buses() -> dict[str, Callable[[], AbstractContextManager["Medium"]]]:
    from canlog.live import medium  # noqa: PLC0415 - not before it is used

    return {
        AUTO: _best_bus,
        "socketcan": medium.open_vcan,
        "udp_multicast": lambda: nullcontext(medium.multicast("it was asked for")),
        "virtual": lambda: nullcontext(medium.virtual("it was asked for")),
    }


@contextmanager
def _best_bus() -> Iterator["Medium"]:
    """Yield a vcan interface made for this test, else multicast UDP, else a bus within this process."""
    from canlog.errors import SourceError  # noqa: PLC0415 - not before it is used
    from canlog.live import medium  # noqa: PLC0415 - likewise

    with medium.open_medium() as opened:
        chosen = opened
        if opened.is_shared:  # by other tests, and by whoever else is on it
            chosen = medium.multicast("making a vcan interface takes root, and others may use the one that is up")
        if chosen.interface == medium.MULTICAST:
            try:
                chosen.open().shutdown()
            except SourceError as exc:
                chosen = medium.virtual(f"{chosen.explanation}, but {exc}")
        yield chosen
