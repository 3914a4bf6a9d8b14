"""Builders, doubles and helpers of the tests, and the processes that tests start."""
