"""What stops a demonstration."""


class DemoError(Exception):
    """The demonstration cannot go on; the text says why."""
