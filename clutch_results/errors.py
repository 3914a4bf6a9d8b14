"""Errors of results."""


class ResultError(Exception):
    """A result does not fit its public form (NaN, unknown key): fix the code that made it, or the file it came from."""
