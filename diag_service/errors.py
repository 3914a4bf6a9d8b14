"""Errors of the diagnostic service; each subclass says what the caller does next."""


class DiagServiceError(Exception):
    """Root of all errors raised by this package; its text is one clear line for the user."""


class ConfigError(DiagServiceError):
    """The command line or a file it names cannot be used: correct it and start again."""


class StoppedError(DiagServiceError):
    """The run was told to stop before it had seen everything: start it again for the whole."""


class IncompleteError(DiagServiceError):
    """A log ends before its own end or lost something: what it holds was shown or written, but that is not all."""


class StoreError(DiagServiceError):
    """The result store cannot be opened or written: results cannot be kept, so stop."""


class StoreFullError(StoreError):
    """The disk takes no more now; what could not be stored may be tried again."""


class PublishError(DiagServiceError):
    """A result could not be delivered now: retry later, the store still has it."""


class PublishRefusedError(PublishError):
    """The broker says no to a message: send something else."""


class ControllerError(DiagServiceError):
    """A controller cannot be asked, or its answer cannot be used: check bus, address and what it is to do."""


class SilentError(ControllerError):
    """A controller did not answer in time: check its address, or ask again later."""


class PendingError(SilentError):
    """A controller asked for more time again and again, and never answered: ask later."""


class MalformedAnswerError(ControllerError):
    """A controller's answer breaks the rules of the standard: nothing that it says is believed."""


class RefusedError(ControllerError):
    """A controller answered that it will not; ``code`` is its negative response code."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code
