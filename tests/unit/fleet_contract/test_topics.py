"""Topics are built and read back, and nothing else is taken for one."""

import pytest

from fleet_contract import Address, Channel, TopicError, parse_topic, topic_of

ADDRESSES = [
    Address(vehicle="car-1", channel=channel, clutch=2 if channel is Channel.CLUTCH else None) for channel in Channel
]


@pytest.mark.parametrize("address", ADDRESSES, ids=lambda address: address.channel.label)
def test_a_topic_is_read_back(address: Address) -> None:
    assert parse_topic(address.topic) == address
    assert topic_of(address.vehicle, address.channel, address.clutch) == address.topic


@pytest.mark.parametrize(
    "topic",
    [
        "",
        "clutchdiag/v1/car1",
        "clutchdiag/v1/car1/shift/1",
        "clutchdiag/v1/car1/clutch",
        "clutchdiag/v1/car1/clutch/3",
        "clutchdiag/v1/car1/horn",
        "clutchdiag/v1/../shift",
        "clutchdiag/v1/car1\n/shift",
        "clutchdiag/v1/+/shift",
        "clutchdiag/v2/car1/shift",
        "x/clutchdiag/v1/car1/shift",
        f"clutchdiag/v1/{'a' * 65}/shift",
    ],
)
def test_no_other_topic_is_ours(topic: str) -> None:
    with pytest.raises(TopicError):
        parse_topic(topic)
