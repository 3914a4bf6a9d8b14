"""One controller from Python: ``UdsTester`` listens first, then asks it."""

from contextlib import ExitStack
from typing import TYPE_CHECKING, Final, Self, TypeVar

from diag_service.api.choices import AnyPath, check_one_bus, optional_path
from diag_service.errors import ConfigError
from diag_service.settings.config import BusConfig
from workshop.tester import questions, scanning
from workshop.tester.addresses import can_address, check_number
from workshop.tester.answers import DEFAULT_SESSION, DialogueCounts
from workshop.tester.asking import (
    LARGEST_LOGICAL,
    BusTarget,
    DoipPlace,
    address_for,
    asking,
    listen_at,
    parse_doip,
    timing_of,
)
from workshop.tester.description import find_description
from workshop.tester.listening import LISTEN_S, HeardTraffic
from workshop.tester.trouble import TroubleCode

if TYPE_CHECKING:
    from collections.abc import Callable

    import can

    from workshop.tester.dialogue import Dialogue

ANSWER_S: Final = 1.0  # until an answer begins


_AnswerT = TypeVar("_AnswerT")


def place_of(
    bus: "can.BusABC | None",
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    doip: str | None,
    ecu: int | None,
    *,
    is_fd: bool,
) -> "BusConfig | can.BusABC | DoipPlace":
    """Return the bus or node to ask; raises ConfigError."""
    check_one_bus(bus, interface, channel, bitrate, doip)
    if doip is not None:
        if ecu is None:
            raise ConfigError("--doip needs --ecu: the logical address of the controller, such as 1011 in hexadecimal")
        check_number("ecu", ecu, LARGEST_LOGICAL)
        return parse_doip(doip, ecu)
    return bus if bus is not None else BusConfig(interface=interface, channel=channel, bitrate=bitrate, is_fd=is_fd)


def scan_controllers(
    bus: "can.BusABC | None" = None,
    *,
    interface: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    is_fd: bool = False,
    doip: str | None = None,
    ecu: int | None = None,
    first: int | None = None,
    last: int | None = None,
    is_extended: bool = False,
    has_all_data: bool = False,
    is_active: bool = False,
    listen_s: float = LISTEN_S,
    timeout_s: float = ANSWER_S,
    wait_s: float = scanning.WAIT_S,
) -> scanning.Scan:
    """Find controllers with their services and data, by requests that change nothing: ``diag-service scan``.

    Parameters
    ----------
    bus, interface, channel, bitrate, is_fd, doip, ecu, listen_s, timeout_s
        As of ``UdsTester``.
    first, last
        Identifiers from which and up to which to try, by default 700 to 7FF; with ``is_extended`` addresses, 00 to FF.
    is_extended
        Whether to try identifiers of 29 bits, 18DAxxF1.
    has_all_data
        Whether to try all data F100 to F1FF, not only those that the standard names.
    is_active
        Whether requests are sent; otherwise ConfigError lists them.
    wait_s
        Time for an answer of each identifier [s].

    Returns
    -------
    Scan
        ``.controllers``, each with its services and data; ``.traffic`` is the traffic before.

    Raises
    ------
    ConfigError, SourceError, ControllerError
        If an argument or the bus cannot be used, another tester is active, or a node is missing.
    """
    plan = scanning.ScanPlan(
        place=place_of(bus, interface, channel, bitrate, doip, ecu, is_fd=is_fd),
        first=first,
        last=last,
        is_extended=is_extended,
        has_all_data=has_all_data,
        is_fd=is_fd,
        listen_s=listen_s,
        timeout_s=timeout_s,
        wait_s=wait_s,
    )
    if not is_active:
        raise ConfigError(f"nothing was sent; with is_active=True this would be asked: {'; '.join(plan.requests)}")
    return scanning.scan(plan)


class UdsTester:
    """A diagnostic tester for one controller (ISO 14229), as ``diag-service dtc``, ``did`` and ``routine`` are.

    ``with UdsTester(bus, is_active=True) as tester:`` listens first, and sends nothing if there is another tester.
    Without ``is_active`` it sends nothing: its questions raise ConfigError with the requests.

    Parameters
    ----------
    bus
        An open bus of python-can, not read by others meanwhile, and not closed. Or name one by the next.
    interface, channel, bitrate
        As of python-can; missing ones come from its environment variables and ``can.conf``.
    is_fd
        Whether requests go out in CAN FD frames.
    doip
        ``HOST[:PORT]`` of a DoIP node in place of a bus; ``ecu`` is its logical address then.
    ecu, reply
        Identifier of requests, and of answers; by default those of the description, or 7E1 and 7E9.
    address
        The controller's address, for extended addressing.
    description
        Description of the controller: TOML, PDX, or the name of a shipped one; by default a shipped one that fits.
    is_active
        Whether requests are sent.
    listen_s, timeout_s
        Time to listen before, and time until an answer must begin [s].

    Raises
    ------
    ConfigError
        If an argument cannot be used.
    SourceError, ControllerError
        At the beginning of the block: if the bus cannot be used, another tester is active, or a node is missing.
    RefusedError, SilentError
        Of a question: if the controller refuses or does not answer. Both are a ControllerError.
    """

    def __init__(
        self,
        bus: "can.BusABC | None" = None,
        *,
        interface: str | None = None,
        channel: str | None = None,
        bitrate: int | None = None,
        is_fd: bool = False,
        doip: str | None = None,
        ecu: int | None = None,
        reply: int | None = None,
        address: int | None = None,
        description: AnyPath | None = None,
        is_active: bool = False,
        listen_s: float = LISTEN_S,
        timeout_s: float = ANSWER_S,
    ) -> None:
        self._timing = timing_of(listen_s, timeout_s)
        self.described = find_description(optional_path(description))
        self._listen_s = listen_s
        self._place = place_of(bus, interface, channel, bitrate, doip, ecu, is_fd=is_fd)
        self._target: BusTarget | DoipPlace
        if isinstance(self._place, DoipPlace):
            if reply is not None or address is not None:
                raise ConfigError("--reply and --address are of a bus, not of --doip")
            self._target = self._place
        else:
            where = address_for(can_address(ecu, reply, address), self.described)
            self._target = BusTarget(bus=self._place, address=where, is_fd=is_fd, listen_s=listen_s)
        self._is_active = is_active
        self._stack = ExitStack()
        self._dialogue: Dialogue | None = None
        self._known = self.described
        self._is_recognised = False
        self._is_at_work = False
        self.traffic: HeardTraffic | None = None
        self.goes_on: Callable[[], bool] = lambda: True  # called during waits; False: StoppedError

    @property
    def controller(self) -> str:
        """The address of the controller, for people."""
        return str(self._target if isinstance(self._target, DoipPlace) else self._target.address)

    @property
    def description(self) -> str:
        """Name of the description in use; known after the first question."""
        return self._known.name

    @property
    def counts(self) -> DialogueCounts:
        """Counts of all questions until now: requests, refusals, silence, stray messages."""
        return DialogueCounts() if self._dialogue is None else self._dialogue.counts

    def __enter__(self) -> Self:
        if self._is_active:
            self._dialogue, self.traffic = self._stack.enter_context(
                asking(self._target, self._timing, goes_on=self.goes_on)
            )
            self._is_at_work = True
        else:
            self.traffic = listen_at(self._place, self._listen_s, self.goes_on)
        return self

    def __exit__(self, *_: object) -> None:
        self._is_at_work = False
        self._stack.close()

    def trouble_codes(
        self, mask: int = questions.FAILED_MASK, *, is_all: bool = False, has_details: bool = True
    ) -> tuple[TroubleCode, ...]:
        """Return the trouble codes: ``diag-service dtc``.

        Parameters
        ----------
        mask
            Status bits of which a code must have one; by default all but those of a test that has not run.
        is_all
            Whether to return all supported codes instead.
        has_details
            Whether to read snapshots and extended data of each.
        """
        return self.ask(questions.TroubleQuestion(mask=0 if is_all else mask, has_details=has_details))

    def clear_trouble_codes(
        self,
        group: int | str = questions.ALL,
        *,
        mask: int = questions.FAILED_MASK,
        is_all: bool = False,
        session: int = DEFAULT_SESSION,
    ) -> questions.Clearing:
        """Clear trouble codes without a confirmation; return those before and after: ``diag-service dtc --clear``.

        Parameters
        ----------
        group
            ``all``, ``obd``, a code such as ``P0811`` or ``P0811-07``, or a group's three bytes, also in hexadecimal.
        mask, is_all
            Which codes are read before and after, as of ``trouble_codes``.
        session
            Session to clear in; left at the end.
        """
        word = group if isinstance(group, str) else f"{group:06X}"
        code_group = questions.parse_group(word, "group")
        return self.ask(questions.ClearQuestion(group=code_group, mask=0 if is_all else mask, session=session))

    def data(self, *data: int | str, session: int = DEFAULT_SESSION) -> tuple[questions.DataAnswer, ...]:
        """Read data by number, as an int or in hexadecimal, or by name: ``diag-service did``.

        Parameters
        ----------
        data
            Identifiers; without any, all of the description.
        session
            Session to ask in; left at the end.
        """
        words = tuple(word if isinstance(word, str) else f"{word:04X}" for word in data)
        return self.ask(questions.DataQuestion(words=words, session=session))

    def routine(
        self,
        routine: int | str,
        action: str,
        *,
        options: bytes = b"",
        session: int = questions.EXTENDED_SESSION,
        unlock: tuple[int, bytes] | None = None,
    ) -> questions.RoutineAnswer:
        """Start or stop a routine, or read its results: ``diag-service routine``.

        Parameters
        ----------
        routine
            Its number, as an int or in hexadecimal, or its name.
        action : {"start", "stop", "results"}
            The action.
        options
            Options of the start.
        session
            Session to ask in; left at the end.
        unlock
            A security level to unlock before, and the mask: the key is the seed XOR the mask.
        """
        word = routine if isinstance(routine, str) else f"{routine:04X}"
        lock = None if unlock is None else questions.Lock(level=unlock[0], mask=unlock[1])
        return self.ask(
            questions.RoutineQuestion(routine=word, action=action, options=options, session=session, lock=lock)
        )

    def ask(self, question: questions.Question[_AnswerT]) -> _AnswerT:
        """Ask and return the answer; raises ConfigError without ``is_active``, and what the question raises."""
        if not self._is_active:
            requests = "; ".join(question.requests(self.described))
            raise ConfigError(f"nothing was sent; with is_active=True this would be asked: {requests}")
        if self._dialogue is None or not self._is_at_work:
            raise ConfigError("the tester is not at work: use it in a with block")
        if not self._is_recognised:
            self._known = questions.recognise(self._dialogue, self.described)
            self._is_recognised = True
        return question.ask(self._dialogue, self._known)
