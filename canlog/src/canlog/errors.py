"""Errors of this package, and a level of log messages between INFO and WARNING."""


class CanlogError(Exception):
    """Base of all errors that this library raises on purpose."""


class DefinitionError(CanlogError):
    """A database, or a signal of it, cannot be used as asked: correct the file or the question."""


class SourceError(CanlogError):
    """A bus or a log cannot be opened or read: check the interface or the file."""


class BusEndedError(SourceError):
    """A bus has come to its regular end, such as that of a simulation: there is nothing more to read."""


class ExtraMissingError(SourceError):
    """A library that only an extra brings is not installed: install it."""


class InputLeftError(SourceError):
    """A stream was left before its end because a stop was requested: say so."""


class OutputError(CanlogError):
    """A file cannot be written: check the disk and the folder."""


NOTICE = 25  # between INFO and WARNING: always shown, nothing is wrong
