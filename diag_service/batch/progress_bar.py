"""How far many drives are: a bar on standard error for whoever waits at a terminal."""

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn


def progress_bar(*, is_shown: bool) -> Progress:
    """Return a bar on standard error: drives, bytes per second, time left; nothing where nobody watches."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[done]}/{task.fields[of]} drives"),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not is_shown or not console.is_terminal,
    )
