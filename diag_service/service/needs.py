"""What friction lacks, signal by signal, and the requests that are known to ask a vehicle for it."""

from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from functools import cache
from types import MappingProxyType
from typing import Final

from clutch_model.calibration import TorqueSource
from clutch_results.records import Tier
from diag_service.diagnosis.capability import SignalNeed
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.asked_signals import READ_DATA, AskedField
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.mapped_messages import lacking, tier_of
from diag_service.mapping.profile import load_shipped, shipped_profiles
from diag_service.mapping.signal_words import signal_words

_MAKER_ENDS: Final = "_"  # profiles are called by the maker, and what follows


def needs_of(
    decoder: Decoder, received: AbstractSet[Signal], torque: TorqueSource, *, knows_gears: bool, has_converter: bool
) -> tuple[SignalNeed, ...]:
    """Return what friction lacks; none where it lacks nothing, or where no shift can be found either.

    Of several signals that would do, those are named that are fewest. A request is of the profile that is used, or of
    one of the same maker: what another maker's car is asked for by a number means something else here.
    """
    asked = {"knows_gears": knows_gears, "has_converter": has_converter}
    if tier_of(received, **asked) in {None, Tier.FRICTION}:
        return ()
    received = received - ({Signal.ENGINE_TORQUE} if torque is not TorqueSource.MEASURED else set())
    wanted = frozenset().union(*(least[0] for least in lacking(Tier.FRICTION, received, **asked)))
    requests = {**_requests_of_maker(decoder.profile_name), **dict(_requests(decoder.profile_name, decoder.asked))}
    needs = []
    for signal in (signal for signal in Signal if signal in wanted):
        profile, request = requests.get(signal, ("", ""))
        needs.append(SignalNeed(signal=signal.value, name=signal_words(signal), request=request, profile=profile))
    return tuple(needs)


def _requests(profile: str, asked: Mapping[Signal, AskedField]) -> Iterator[tuple[Signal, tuple[str, str]]]:
    for signal, field in asked.items():
        digits = 4 if field.service == READ_DATA else 2
        yield signal, (profile, f"{field.service:02X} {field.number:0{digits}X} at {field.request_id:X}")


@cache
def _requests_of_maker(profile: str) -> Mapping[Signal, tuple[str, str]]:
    """Return who asks for which signals, of the shipped profiles of the maker of one of them."""
    maker = profile.partition(_MAKER_ENDS)[0]
    requests: dict[Signal, tuple[str, str]] = {}
    if profile in shipped_profiles():
        for name in shipped_profiles():
            if name.partition(_MAKER_ENDS)[0] == maker:
                requests |= dict(_requests(name, load_shipped(name).asked))
    return MappingProxyType(requests)
