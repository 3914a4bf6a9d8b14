"""One shift out of a recording, decoded as the service decodes it."""

from pathlib import Path

from dbc.contract import DBC_PATH
from demo.errors import DemoError
from diag_service.decoding.mapping import Decoder
from diag_service.definitions.database import load_database
from diag_service.definitions.profile import load_profile
from diag_service.events import ShiftEvent
from diag_service.shift_finding.shifts import ShiftFinder
from diag_service.sources import read_log


def recorded_shift(path: Path, number: int) -> ShiftEvent:
    """Return one shift of a recorded drive, by its number.

    Raises
    ------
    DemoError
        If the recording has no such shift.
    """
    decoder, finder = Decoder(load_database(DBC_PATH), load_profile()), ShiftFinder()
    events = [event for batch in read_log(path) for columns in decoder.feed(batch) for event in finder.feed(columns)]
    for event in [*events, *finder.flush()]:
        if event.number == number:
            return event
    raise DemoError(f"{path} has no shift {number}")
