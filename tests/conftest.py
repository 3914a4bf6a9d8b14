"""What every test run loads; fixtures live in tests/plugins, one subject per module."""

pytest_plugins = [
    "tests.plugins.broker",
    "tests.plugins.disk",
    "tests.plugins.drives",
    "tests.plugins.postgres",
    "tests.plugins.run_report",
    "tests.plugins.vcan",
]
