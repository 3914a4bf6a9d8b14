"""A fixture of a test bench: an emulated car on a bus, a tester that asks it, and what is true (docs/python.md).

Nothing is loaded until the fixture is used.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    import can

    from ecu_emulator import Emulator, TruthLog
    from workshop.tester.uds_tester import UdsTester

FIRST_VALUES_S = 0.2  # by then every message of the controller has been sent
PATIENCE_S = 300.0  # with a machine that compiles kernels, or has much else to do


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualCar:
    """A car that drives and answers testers."""

    emulator: "Emulator"
    bus: "can.BusABC"  # an end of its bus
    uds: "UdsTester"

    @property
    def truth(self) -> "TruthLog":
        """What was true of the shifts until now."""
        return self.emulator.truth


@pytest.fixture
def virtual_car() -> Iterator[Callable[..., VirtualCar]]:
    """Return a function that starts a car and returns it; it stops with the test.

    ``virtual_car("ideal", cause="glazed_lining", strength=1.5, clutch=1, seed=7)``: the cause is one that
    ``Emulator.add_fault`` takes, 1 the smallest strength that matters; other arguments are those of ``Emulator``.
    """
    with ExitStack() as stack:

        def start(
            scenario: Any = "ideal",  # noqa: ANN401 - as Emulator takes it
            *,
            cause: str | None = None,
            strength: float = 1.0,
            clutch: int = 0,
            **options: Any,  # noqa: ANN401 - likewise
        ) -> VirtualCar:
            from ecu_emulator import Emulator  # noqa: PLC0415 - not before it is used
            from workshop import Answers, UdsTester  # noqa: PLC0415 - likewise

            faults = [*options.pop("faults", ())]
            if cause is not None:
                faults.append({"kind": cause, "strength": strength, "clutch": clutch})
            wanted = {"answers": Answers(), "is_prompt": True, **options}
            car = stack.enter_context(Emulator(scenario, faults=faults, **wanted))
            bus, asking = (stack.enter_context(car.open_bus()) for _ in range(2))
            car.wait_until(FIRST_VALUES_S, PATIENCE_S)
            uds = stack.enter_context(UdsTester(asking, is_active=True, timeout_s=PATIENCE_S))
            return VirtualCar(emulator=car, bus=bus, uds=uds)

        yield start
