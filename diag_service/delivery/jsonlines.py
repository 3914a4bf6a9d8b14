"""One JSON object per line on standard output, for the next program in a pipe; text for people goes elsewhere."""

from typing import TextIO

from rich.console import Console

from diag_service.diagnosis.records import ShiftResult
from diag_service.diagnosis.results import dump, shift_record
from diag_service.diagnosis.summary import Summary, summary_record


class JsonLinesReporter:
    """Writes a shift record per shift and a summary record at the end; each line is flushed."""

    def __init__(self, stream: TextIO, people: Console) -> None:
        self._stream = stream
        self._people = people

    def listening(self, where: str) -> None:
        """Say so to people; the JSON stream holds records only."""
        self._people.print(f"listening on {where}", highlight=False, markup=False, soft_wrap=True)

    def report(self, result: ShiftResult) -> None:
        """Write one shift."""
        self._write(dump(shift_record(result)))

    def finish(self, summary: Summary) -> None:
        """Write the numbers of the run."""
        self._write(dump(summary_record(summary)))

    def _write(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()
