"""Shared by all commands: results on stdout, messages on stderr, and arguments that name recordings."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread, current_thread, main_thread
from typing import Annotated

import typer

from greygate import schemas
from greygate.errors import InputError, one_line
from greygate.names import check_text
from greygate.progress import Budget, Progress

SILENCE = 5.0  # s between two lines of long work, where stderr is no terminal
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def give(schema: str, result: object, as_json: bool, lines: list[str], yes: bool = True) -> None:
    """Print the result of a command: as JSON of that schema, or the lines that a person reads.

    yes: else the answer is no, and the exit code 1.
    """
    print_out(schemas.text(schema, result) if as_json else "\n".join(lines))
    if not yes:
        raise typer.Exit(1)


def print_out(text: str) -> None:
    """Print to stdout; it is no error if the reader, such as `| head`, has closed it."""
    try:
        typer.echo(text)
    except BrokenPipeError:  # the rest of the output is dropped
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say(text: str) -> None:
    """Print one line on stderr, whatever the text holds."""
    typer.echo(one_line(" ".join(text.split())), err=True)


def finite(value: float | None, form: str) -> str:
    """Format a number; None, which JSON holds instead of an infinity, becomes "inf"."""
    return "inf" if value is None else f"{value:{form}}"


@contextmanager
def following(title: str) -> Iterator[Progress]:
    """Show a line on stderr while long work runs; yield the `progress` that changes this line.

    Where stderr is no terminal, the line is printed every few seconds.
    """
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(title) as status:
            yield lambda line: status.update(f"{title}: {line}")
    else:
        with _repeating(title) as progress:
            yield progress


@contextmanager
def ended_early(budget: Budget) -> Iterator[Budget]:
    """The first Ctrl-C ends the budget, and a further one the command."""

    def end(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, before)
        budget.stop()
        say("ending with what was found so far; Ctrl-C once more ends at once")

    if current_thread() is not main_thread():
        yield budget
        return
    before = signal.signal(signal.SIGINT, end)
    try:
        yield budget
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _repeating(title: str) -> Iterator[Progress]:
    """Print what `progress` was last given, and for how long, every SILENCE seconds."""
    last, done, start = [title], Event(), time.monotonic()

    def repeat() -> None:
        while not done.wait(SILENCE):
            say(f"{last[0]} ({time.monotonic() - start:.0f} s)")

    thread = Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield lambda line: last.__setitem__(0, f"{title}: {line}")
    finally:
        done.set()
        thread.join()


@contextmanager
def counting(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar on stderr while `total` things are done; yield the call that says how many are done."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)


def named(text: str) -> str:
    """Return the argument as SCENARIO=FILE.csv; the scenario of a file alone has the file's name."""
    return text if "=" in text else f"{Path(text).stem}={text}"


def recordings(given: list[str]) -> dict[str, str]:
    """Scenario -> CSV file, from arguments such as "training=train.csv" or "train.csv"."""
    found: dict[str, str] = {}
    for text in map(named, given):
        scenario, equals, path = text.partition("=")
        if not equals or not scenario:
            raise InputError(f"recording {text}: write SCENARIO=FILE.csv, e.g. training=train.csv")
        check_text(scenario, "recording, scenario")
        if scenario in found:
            raise InputError(f"recording {text}: the scenario {scenario} is given twice; rename one of them")
        found[scenario] = path
    return found
