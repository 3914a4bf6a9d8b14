"""Pytest plugin: the tests in another order, the same again for the same number: ``--order-seed 17``.

Files are shuffled, and the tests of each file. A file's tests stay together, so that what they share is made once.
The order depends on the number alone, so every worker of pytest-xdist collects the same one.
"""

import random
from collections import defaultdict

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the number that an order comes from."""
    parser.addoption("--order-seed", type=int, metavar="N", help="shuffle the tests; the same N gives the same order")


def pytest_report_header(config: pytest.Config) -> str | None:
    """Say how this order is had again."""
    number = config.getoption("order_seed")
    return None if number is None else f"order: --order-seed {number}"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Shuffle what is left when the marks have chosen; without a number what takes longest begins first."""
    number = config.getoption("order_seed")
    if number is None:
        items.sort(key=lambda item: "image" not in getattr(item, "fixturenames", ()))
        return
    files = defaultdict(list)
    for item in items:
        files[item.path].append(item)
    chance = random.Random(number)  # noqa: S311 - an order is no secret
    groups = list(files.values())
    chance.shuffle(groups)
    for group in groups:
        chance.shuffle(group)
    items[:] = [item for group in groups for item in group]
