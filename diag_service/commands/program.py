"""What all commands share: the name of the program, and the option for JSON. Imports next to nothing."""

from typing import Final

from clutchdiag_io.command_line import Option

PROGRAM: Final = "diag-service"
JSON: Final = Option("--json", "one JSON object on standard output")
