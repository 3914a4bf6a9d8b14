"""One shift out of a recording, decoded as the service decodes it."""

from pathlib import Path

from canlog.logs import read_log
from dbc.contract import load_contract
from demo.errors import DemoError
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile


def recorded_shift(path: Path, number: int) -> Event:
    """Return one shift of a recorded drive, by its number.

    Raises
    ------
    DemoError
        If the recording has no such shift.
    """
    decoder, finder = Decoder(load_contract(), load_profile()), ShiftFinder()
    events = [event for batch in read_log(path) for columns in decoder.feed(batch) for event in finder.feed(columns)]
    for event in [*events, *finder.flush()]:
        if event.number == number:
            return event
    raise DemoError(f"{path} has no shift {number}")
