"""Arguments of the Python functions, and how they become the options of a command."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypedDict

from clutch_model.calibration import Calibration
from diag_service.errors import ConfigError
from diag_service.settings.config import PollConfig

if TYPE_CHECKING:
    import can

AnyPath = str | os.PathLike[str]
AnyPaths = AnyPath | Iterable[AnyPath]
_FILES: Final = frozenset({"dbc", "profile", "calibration", "ca", "cert", "key", "password_file"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Delivery:
    """Where results are sent; each member is the option of that name.

    Attributes
    ----------
    broker : str
        ``mqtt[s]://[user[:password]@]host[:port]``.
    ca, cert, key, password_file : path, optional
        Files for an encrypted connection, and with the password; key and password are readable for their owner only.
    acknowledge : "broker" or "backend"
        Whose word lets a result be forgotten.
    """

    broker: str
    ca: AnyPath | None = None
    cert: AnyPath | None = None
    key: AnyPath | None = None
    password_file: AnyPath | None = None
    acknowledge: Literal["broker", "backend"] = "broker"


@dataclass(frozen=True, slots=True, kw_only=True)
class Poll:
    """Periodic requests for a controller's trouble codes during a live diagnosis; each member is an option of ``run``.

    To make one is the leave to send requests, as ``--active`` is.

    Attributes
    ----------
    period_s : float
        From one answer to the next question, 1 s or more.
    ecu, reply : int, optional
        Identifier of requests, and of answers; by default as described, or 7E1 and what the standard has for it.
    description : path, optional
        What the controller has: TOML, PDX, or the name of a shipped one; by default what it says it is.
    bus : can.BusABC, optional
        An open end of the bus for the questions alone. A bus that is diagnosed by its name is opened once more instead.
    """

    period_s: float = 60.0
    ecu: int | None = None
    reply: int | None = None
    description: AnyPath | None = None
    bus: "can.BusABC | None" = None


class FrameMeaning(TypedDict, total=False):
    """What frames mean and whose they are, as functions take it by keyword; ``analyze`` says what each stands for."""

    vehicle: str | None
    dbc: AnyPath | None
    profile: AnyPath | None
    calibration: Calibration | AnyPath | None


class LogMeaning(FrameMeaning, total=False):
    """The same of logs, which may be tables."""

    columns: str


def named(meaning: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords as the fields of the options of a command, which name files as paths."""
    return {
        name: Path(value) if name in _FILES and isinstance(value, str | os.PathLike) else value
        for name, value in meaning.items()
    }


def sent_to(delivery: Delivery | None) -> dict[str, Any]:
    """Return the broker that gets results as fields of the options of a command."""
    return {} if delivery is None else named(asdict(delivery))


def path_list(paths: AnyPaths) -> tuple[Path, ...]:
    """Return one path or several; raises ConfigError if there is none."""
    files = (Path(paths),) if isinstance(paths, str | os.PathLike) else tuple(map(Path, paths))
    if not files:
        raise ConfigError("no log is named")
    return files


def optional_path(path: AnyPath | None) -> Path | None:
    return None if path is None else Path(path)


def poll_config(poll: Poll | None) -> PollConfig | None:
    """Return how a controller is asked; raises ConfigError."""
    if poll is None:
        return None
    return PollConfig(
        period_s=poll.period_s,
        ecu=None if poll.ecu is None else f"{poll.ecu:X}",
        reply=None if poll.reply is None else f"{poll.reply:X}",
        description=optional_path(poll.description),
        bus=poll.bus,
    )


def check_one_bus(bus: "can.BusABC | None", *names: object) -> None:
    """Raise ConfigError if a bus was handed over open and named besides."""
    if bus is not None and any(name is not None and name is not False for name in names):
        raise ConfigError("give either an open bus or an interface and a channel, not both")
