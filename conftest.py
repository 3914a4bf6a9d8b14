"""What every test run loads; fixtures live in tests/plugins, one subject per module."""

import atexit
import gc

from hypothesis import HealthCheck, settings

# A busy machine is no fault of the code.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

pytest_plugins = [
    "tests.plugins.asked_services",
    "tests.plugins.broker",
    "tests.plugins.disk",
    "tests.plugins.drives",
    "tests.plugins.image",
    "tests.plugins.order",
    "tests.plugins.postgres",
    "tests.plugins.run_report",
    "tests.plugins.silkit",
    "tests.plugins.vcan",
]


def pytest_collection_finish() -> None:
    """Spare the garbage collector what all tests are made of: it lives as long as they do."""
    gc.collect()
    gc.freeze()
    atexit.register(gc.unfreeze)  # or libraries say at the end what was not given back to them
