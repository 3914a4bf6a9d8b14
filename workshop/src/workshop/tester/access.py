"""The way to the controllers of a car that is tried: a bus, or an adapter whose dialogue is copied to a virtual one."""

import uuid
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol

from diag_service.errors import ConfigError
from diag_service.mapping.profile import AskingRules, Profile
from diag_service.settings.config import BusConfig
from workshop.tester.adapters import Line, line_through, parse_adapter, rules_through
from workshop.tester.addresses import is_extended
from workshop.tester.asking import listen_at
from workshop.tester.can_line import line_on
from workshop.tester.listening import HeardTraffic
from workshop.tester.signal_asking import NO_GROUPS, address_of

GoesOn = Callable[[], bool]


class CarAccess(Protocol):
    """A way to controllers."""

    @property
    def bus(self) -> BusConfig:
        """The bus on which the dialogue can be read."""

    @property
    def words(self) -> list[str]:
        """Options that name it on a command line."""

    def listen(self, listen_s: float, goes_on: GoesOn) -> HeardTraffic | None:
        """Return what is said there; None: nothing is heard that was not asked for.

        Raises SourceError, ControllerError, StoppedError.
        """

    def usable(self, profiles: Sequence[Profile], traffic: HeardTraffic | None) -> list[Profile]:
        """Return the profiles that can be asked by; raises ConfigError if none can."""

    def rules(self, profile: Profile) -> AskingRules:
        """Return what can be asked at once."""

    def opened(self, profiles: Sequence[Profile], listen_s: float, goes_on: GoesOn) -> AbstractContextManager[Line]:
        """Open it; raises ConfigError, SourceError, ControllerError, StoppedError."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BusAccess:
    """A bus, on which other testers are listened for."""

    bus: BusConfig

    @property
    def words(self) -> list[str]:
        """Options that name it on a command line."""
        given = (("-i", self.bus.interface), ("-c", self.bus.channel), ("-b", self.bus.bitrate))
        named = [word for option, value in given if value is not None for word in (option, str(value))]
        return [*named, "--fd"] if self.bus.is_fd else named

    def listen(self, listen_s: float, goes_on: GoesOn) -> HeardTraffic | None:
        """Return what is said on the bus; raises SourceError, ControllerError, StoppedError."""
        return listen_at(self.bus, listen_s, goes_on)

    def usable(self, profiles: Sequence[Profile], traffic: HeardTraffic | None) -> list[Profile]:
        """Return the profiles that can be asked by: none of J1939 among several where no frame has 29 bits."""
        if len(profiles) == 1 or (traffic is not None and any(map(is_extended, traffic.can_ids))):
            return [*profiles]
        return [profile for profile in profiles if not profile.groups]

    def rules(self, profile: Profile) -> AskingRules:
        """Return what can be asked at once."""
        return profile.asking

    def opened(self, profiles: Sequence[Profile], listen_s: float, goes_on: GoesOn) -> AbstractContextManager[Line]:
        """Open the bus; raises SourceError, ControllerError, StoppedError."""
        addresses = [address_of(asked) for profile in profiles for asked in profile.asked.values()]
        groups = [pgn for profile in profiles for pgn in profile.groups.values()]
        return line_on(self.bus, addresses, groups, is_fd=self.bus.is_fd, listen_s=listen_s, goes_on=goes_on)


def _virtual_bus() -> BusConfig:
    return BusConfig(interface="virtual", channel=f"try-{uuid.uuid4()}", bitrate=None, is_fd=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class AdapterAccess:
    """An ELM327 adapter or a DoIP node; raises ConfigError if its name is none."""

    url: str
    bus: BusConfig = field(default_factory=_virtual_bus)

    def __post_init__(self) -> None:
        parse_adapter(self.url)

    @property
    def words(self) -> list[str]:
        """Options that name it on a command line."""
        return ["--adapter", self.url]

    def listen(self, listen_s: float, goes_on: GoesOn) -> None:
        """Return None: nothing is heard that was not asked for."""
        del listen_s, goes_on

    def usable(self, profiles: Sequence[Profile], traffic: HeardTraffic | None) -> list[Profile]:
        """Return the profiles that can be asked by; raises ConfigError if none can."""
        del traffic
        if not (without_groups := [profile for profile in profiles if not profile.groups]):
            raise ConfigError(NO_GROUPS)
        return without_groups

    def rules(self, profile: Profile) -> AskingRules:
        """Return what can be asked at once."""
        return rules_through(self.url, profile.asking)

    def opened(self, profiles: Sequence[Profile], listen_s: float, goes_on: GoesOn) -> AbstractContextManager[Line]:
        """Open the adapter; raises ControllerError, StoppedError."""
        del profiles, listen_s
        return line_through(self.url, str(self.bus.channel), goes_on)
