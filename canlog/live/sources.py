"""What every live source of frames offers, whatever bus it listens to."""

from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, fields
from typing import Final, Protocol, TypeVar

from canlog.frames import MAX_GAP_NS, FrameBatch

SILENCE_S: Final = 1.5e-9 * MAX_GAP_NS  # whatever comes after it, its time begins another stretch
NS_PER_S: Final = 1_000_000_000
RELAXED_S: Final = 0.5  # 2,200 frames of a full bus of 500 kbit/s, a quarter of what the receive buffer holds
EXPECTING_S: Final = 0.1  # no longer than what a shift needs after its end: its end is known before that is over
URGENT_S: Final = 0.01
LATE_S: Final = 0.002  # frames of the moment that is waited for must have arrived

Listener = Callable[[], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceCounts:
    """Frames of a live bus, counted since the source was opened.

    ``received + kernel_dropped`` frames were on the bus; ``received - queue_dropped - unsupported`` were handed over.
    """

    received: int = 0  # read from the interface
    kernel_dropped: int = 0  # lost in the socket's receive buffer, as the kernel counts them
    queue_dropped: int = 0  # read, but the service was too far behind to keep them
    unsupported: int = 0  # neither CAN nor CAN FD
    clock_steps: int = 0  # of the wall clock; bus time does not follow them

    def __add__(self, other: "SourceCounts") -> "SourceCounts":
        names = [field.name for field in fields(self)]
        return SourceCounts(**{name: getattr(self, name) + getattr(other, name) for name in names})


@dataclass(frozen=True, slots=True)
class Silence:
    """The bus has said nothing for ``SILENCE_S``: nothing that comes can belong to the stretch before any more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkBreak:
    """The bus was away: what comes after is another stretch, whatever its times say."""

    problem: str


PartT_co = TypeVar("PartT_co", covariant=True)


class Source(Protocol[PartT_co]):
    """A live bus, part by part, oldest first.

    Iteration ends after ``aclose``, with all frames received until then handed over, and raises ``SourceError`` when
    the bus fails; frames received before the failure are handed over first.
    """

    @property
    def description(self) -> str:
        """Interface and channel, for people."""

    @property
    def counts(self) -> SourceCounts:
        """What has been received and lost until now; exact, also after the source was closed."""

    def __aiter__(self) -> AsyncIterator[PartT_co]:
        """Iterate over the parts."""

    async def aclose(self) -> None:
        """Stop receiving; a second call does nothing."""


FrameSource = Source[FrameBatch | Silence]
LiveSource = Source[FrameBatch | Silence | LinkBreak]  # what a live run reads: a bus that failed may come back


class ReadSchedule:
    """What a source and its consumer agree on: the consumer tells what it waits for.

    Nothing hurries while nothing can come of it. Once it is known at which bus time a result will be there, the
    frames are looked at just then.
    """

    def __init__(self) -> None:
        self._is_expecting = False
        self._due_ns: int | None = None
        self.on_change: Listener = lambda: None  # the source's, to think again about a time it has set

    def wait_for(self, *, is_expecting: bool, due_ns: int | None) -> None:
        """Tell what is waited for.

        Parameters
        ----------
        is_expecting
            Whether a shift has begun.
        due_ns
            Bus time beyond which the next shift is known in full, if it has ended.
        """
        if (is_expecting, due_ns) != (self._is_expecting, self._due_ns):
            self._is_expecting, self._due_ns = is_expecting, due_ns
            self.on_change()

    def gather_s(self, seen_ns: int | None) -> float:
        """For how long frames may gather that come after bus time ``seen_ns`` [s]."""
        longest_s = EXPECTING_S if self._is_expecting else RELAXED_S
        if self._due_ns is None or seen_ns is None:
            return longest_s
        return min(max((self._due_ns - seen_ns) / NS_PER_S + LATE_S, URGENT_S), longest_s)
