"""What asyncio's task groups and runner leave to be done."""

import asyncio
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

ResultT = TypeVar("ResultT")


def first_error(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """Return the error that ended a task group; what it caused in other tasks came after it."""
    first = group.exceptions[0]
    return first_error(first) if isinstance(first, BaseExceptionGroup) else first


def run_to_end(work: Coroutine[None, None, ResultT]) -> ResultT:
    """Run a coroutine in a loop of its own; where the caller has one that runs, as in a notebook, in another thread."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(work)
    with ThreadPoolExecutor(1, "own loop") as thread:
        return thread.submit(copy_context().run, asyncio.run, work).result()
