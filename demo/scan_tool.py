"""A scan tool at the emulated controller: it asks over IP, so that the bus carries the drive alone, until its end."""

import threading
from typing import Final, Self

from demo.programs import HOST, free_port
from diag_service.errors import ControllerError
from workshop.tester.answers import TesterTiming
from workshop.tester.asking import DoipPlace, dialogue_over_ip
from workshop.tester.questions import read_troubles, recognise
from workshop.tester.trouble import code_words

LOGICAL_ADDRESS: Final = 0x1011  # of the emulated controller
PERIOD_S: Final = 1.0


class ScanTool:
    """Reads the trouble codes every second while entered, once somebody answers; keeps the last answer."""

    def __init__(self) -> None:
        self._place = DoipPlace(host=HOST, port=free_port(), logical_address=LOGICAL_ADDRESS)
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="scan tool", daemon=True)
        self._told = "no answer"

    @property
    def emulator_arguments(self) -> tuple[str, ...]:
        """The options with which the emulator answers it."""
        return "--diagnostics", "--doip", f"{self._place.host}:{self._place.port}"

    @property
    def line(self) -> str:
        """What it was told last."""
        return f"scan tool: {self._told}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._is_over.wait(PERIOD_S):
            try:
                self._ask()
            except ControllerError:  # it is not there yet, or not any more
                continue

    def _ask(self) -> None:
        with dialogue_over_ip(self._place, TesterTiming()) as dialogue:
            description = recognise(dialogue)
            while not self._is_over.wait(PERIOD_S):
                codes = read_troubles(dialogue, description, has_details=False)
                self._told = ", ".join(map(code_words, codes)) or "no trouble codes"
