"""From options to what is written as a table; one table and a folder of tables share it."""

from collections.abc import Sequence
from types import SimpleNamespace

from cantools.database.can import Message

from canlog.errors import SourceError
from canlog.tables.decoding import Plan
from canlog.written_tables import TableChoice
from diag_service.commands.conversations import pairs_of
from diag_service.errors import ConfigError


def choice_of(options: SimpleNamespace) -> TableChoice:
    """Return what is asked for; raises ConfigError if pairs are none."""
    return TableChoice(
        shape=options.layout,
        values=options.values,
        signals=tuple(name.strip() for name in (options.signals or "").split(",") if name.strip()),
        begin=vars(options)["from"],
        end=options.to,
        columns=options.columns or "",
        pairs=pairs_of(options.pairs or ""),
    )


def planned(choice: TableChoice, messages: Sequence[Message]) -> Plan:
    """Return the plan for what is asked for; raises ConfigError if a text is no time."""
    try:
        return choice.plan(messages)
    except SourceError as exc:
        raise ConfigError(str(exc)) from exc
