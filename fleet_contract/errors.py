"""Errors of the contract. Who receives a message that raises one keeps it aside: sent again, it fails again."""

from typing import ClassVar


class ContractError(Exception):
    """Root of all errors raised by this package; its text is one line and quotes little of what it refuses."""

    reason: ClassVar[str] = "schema"  # in one word


class TopicError(ContractError):
    """A topic that this contract does not know."""

    reason = "topic"


class MalformedError(ContractError):
    """Bytes that are no acceptable JSON: too long, too deep, not finite, a name twice."""

    reason = "malformed"


class SchemaError(ContractError):
    """JSON that is not what its schema describes."""


class IdentityError(ContractError):
    """A message that says it is of another vehicle, stream or key than its topic or its envelope."""

    reason = "identity"  # of the fleet's view identity_alarm, too


class VariableError(ContractError):
    """An environment variable of our prefix that nothing reads: correct its name."""


class ResultError(Exception):
    """A result does not fit its public form (NaN, unknown key): fix the code that made it, or the file it came from."""
