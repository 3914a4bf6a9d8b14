"""What a message of the fleet contract costs its reader: JSON, schemas, identity, and the schemas alone.

python -m studies.contract
"""

import json
from collections.abc import Callable
from statistics import median

from jsonschema import Draft202012Validator

from studies.measuring import machine, took_s
from fleet_contract import Outgoing, parse_topic, read_message, schema
from fleet_contract.schema_check import compile_schema
from tests.golden import messages_v1

CALLS = 2_000
ROUNDS = 9
SLOW_CALLS = 200


def each_us(work: Callable[[], object], calls: int = CALLS) -> float:
    """Return the median time of one call [us]."""

    def all_calls() -> None:
        for _ in range(calls):
            work()

    return median(took_s(all_calls) for _ in range(ROUNDS)) / calls * 1e6


def measured_us(message: Outgoing) -> tuple[float, float, float]:
    """Return what a message costs [us]: read as a whole, held against its schemas, and that by the oracle."""
    event, label = json.loads(message.payload), parse_topic(message.topic).channel.label
    checks = [(compile_schema(schema(name)), part) for name, part in (("event", event), (label, event["data"]))]
    oracles = [(Draft202012Validator(schema(name)), part) for name, part in (("event", event), (label, event["data"]))]
    return (
        each_us(lambda: read_message(message.topic, message.payload)),
        each_us(lambda: [check(part) for check, part in checks]),
        each_us(lambda: [oracle.is_valid(part) for oracle, part in oracles], SLOW_CALLS),
    )


def main() -> None:
    print(f"{machine()}\n{'message':16} {'read':>8} {'schemas':>8} {'jsonschema':>11}  [us]")
    for name, message in messages_v1().items():
        read_us, schemas_us, oracle_us = measured_us(message)
        print(f"{name:16} {read_us:8.1f} {schemas_us:8.1f} {oracle_us:11.1f}")


if __name__ == "__main__":
    main()
