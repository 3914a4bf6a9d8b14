"""Errors of the emulator; each subclass says what the caller does next."""


class EmulatorError(Exception):
    """Root of all errors raised by this package; its text is one clear line for the user."""


class EmulatorStoppedError(EmulatorError):
    """The program was told to stop before it had done anything: start it again."""


class EmulatorConfigError(EmulatorError):
    """The command line or a scenario cannot be used: correct it and start again."""


class BusError(EmulatorError):
    """The bus cannot be opened or no longer takes frames: check the interface."""


class RecordError(EmulatorError):
    """A file cannot be written: check its folder and the space left."""


class LogFormatExtraError(RecordError):
    """A log format needs a library that only an extra brings: install it."""
