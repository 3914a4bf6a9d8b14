"""An option that need not stand on the command line."""

from typing import Any, Final

import click

from clutchdiag_io.command_line import Choice, Option
from diag_service.errors import ConfigError

_KINDS: Final = {
    "boolean": "true or false",
    "float": "a number",
    "int": "a whole number",
    "path": "a file name",
    "text": "a text",
}


class Setting(Option):
    """An option that the environment or a settings file may set, under its name with ``_`` for ``-``."""

    can_be_set = True

    @property
    def demand(self) -> str:
        """What a value must be."""
        if isinstance(self.type, Choice):
            return f"must be {' or '.join(self.type.choices)}"
        return f"must be {_KINDS[self.type.name]}"

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:  # noqa: ANN401 - as click has it
        """Return what a text stands for; of the environment's texts none is repeated, since it may be secret."""
        try:
            return super().type_cast_value(ctx, value)
        except click.BadParameter:
            if ctx.get_parameter_source(self.name) is click.ParameterSource.COMMANDLINE:
                raise
            raise ConfigError(f"settings: {self.name}: {self.demand}") from None
