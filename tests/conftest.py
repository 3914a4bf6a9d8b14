"""What every test run loads; fixtures live in tests/plugins, one subject per module."""

from hypothesis import settings

settings.register_profile("untimed", deadline=None)  # a busy machine is no fault of the code
settings.load_profile("untimed")

pytest_plugins = [
    "tests.plugins.broker",
    "tests.plugins.disk",
    "tests.plugins.drives",
    "tests.plugins.postgres",
    "tests.plugins.run_report",
    "tests.plugins.vcan",
]
