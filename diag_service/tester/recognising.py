"""Which of the shipped descriptions fits a controller: by what it says of itself."""

from typing import TYPE_CHECKING

from diag_service.errors import ControllerError, PendingError
from diag_service.tester.answers import READ_DATA
from diag_service.tester.description import UNKNOWN, Description
from diag_service.tester.description_file import shipped

if TYPE_CHECKING:
    from diag_service.tester.dialogue import Dialogue


def recognised(tester: "Dialogue", description: Description = UNKNOWN) -> Description:
    """Return a description; without one the shipped one that fits, or else what all controllers have.

    Without one it asks for a datum or two.
    """
    if description is not UNKNOWN:
        return description
    for described in shipped():
        if described.identity is None:
            continue
        try:
            response = tester.ask(bytes([READ_DATA]) + described.identity.number.to_bytes(2, "big"))
        except PendingError:  # whoever asks next would wait as long
            raise
        except ControllerError:  # it will not tell, or not answer: the question that follows says so
            continue
        if response[3:].rstrip(b"\0 ").decode("latin-1") == described.identity.text:
            return described.description
    return UNKNOWN
