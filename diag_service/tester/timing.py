"""How a tester behaves, and what a dialogue went through: plain values that need no library."""

from dataclasses import dataclass
from typing import Final

DEFAULT_SESSION: Final = 0x01
STOPPED: Final = "stopped early: not everything was asked"


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Times and counts of a tester (ISO 14229-2): how long it waits, how soon and how often it asks again."""

    p2_s: float = 1.0  # until an answer begins; a controller has 0.05 s, what is between them the rest
    p2_star_s: float = 6.0  # after the controller said that it takes longer (78)
    longest_s: float = 60.0  # of one question, however often the controller asks for patience
    gap_s: float = 0.01  # between an answer and the next question: others want to be heard as well
    busy_pause_s: float = 0.1  # after 21; doubled each time
    most_busy: int = 6
    most_silent: int = 2  # times that a question is asked that is not answered


@dataclass(slots=True)
class DialogueCounts:
    """What a dialogue went through."""

    requests: int = 0
    refusals: int = 0
    busy: int = 0  # answered 21
    silent: int = 0  # not answered in time
    stray: int = 0  # messages that were no answer to what was asked
