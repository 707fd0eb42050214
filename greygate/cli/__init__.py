"""The command line. Results go to stdout, messages to stderr; exit 0 done, 1 the answer is no, 2 wrong use.

A command is a function of `networks`, `builds` or `rigs`; it imports what it needs when it runs, so that `greygate
--help` starts fast.
"""

import io
import signal
import sys
from threading import Timer, get_ident
from typing import Annotated, Any

import typer

from greygate import __version__
from greygate.cli import (
    bench,
    boards,
    builds,
    compiling,
    controlling,
    exports,
    networks,
    recordings,
    rigs,
    tools,
    whole,
)
from greygate.cli.grammar import Commands
from greygate.cli.terminal import say
from greygate.errors import InputError
from greygate.system import again

INTERRUPTED, TERMINATED = 130, 143  # exit codes after Ctrl-C and after `kill`, as shells give them
AGAIN_S = 0.05  # so long a signal that was ignored waits: longer than a callback, shorter than one notices
UsageError: Any = typer.BadParameter.__base__  # raised for an argument or option that is missing, unknown or wrong
# What signals have raised: held to the end with its frames, since llvmlite frees twice what one of them cut in two
_stopped: list[KeyboardInterrupt | SystemExit] = []
DEVELOPERS = "Developers"
COMMANDS = {  # heading -> commands; those for developers are a group
    "The whole way": (whole.make, tools.app),
    "Data": (recordings.demo, recordings.look, recordings.init, recordings.init_rig),
    "Networks": (networks.identify, networks.train, networks.build_snn, networks.validate, controlling.control),
    "Hardware": (
        *(compiling.compile, compiling.explore, builds.emulate, builds.verify, builds.prove, builds.synthesize),
        *(builds.report, builds.compare, boards.board, boards.play),
    ),
    "Diagnosis": (rigs.diagnose, rigs.next_, rigs.isolability, rigs.simulate, rigs.augment),
    "Other tools": (tools.ci_template, tools.doctor),
    DEVELOPERS: (rigs.conceal, rigs.reveal, tools.schema),
}

app = typer.Typer(
    cls=Commands,
    help="Grey-box networks from a mechanical plant to an FPGA.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
dev = typer.Typer(help="Test the diagnosis, and read the schemas of greygate's JSON.", no_args_is_help=True)
for heading, commands in COMMANDS.items():
    for command in commands:
        group = dev if heading == DEVELOPERS else app
        group.command(command.__name__.rstrip("_").replace("_", "-"), rich_help_panel=heading)(command)
app.add_typer(exports.app, name="export", rich_help_panel="Other tools")
dev.add_typer(bench.app, name="bench-concealed")
app.add_typer(dev, name="dev", rich_help_panel=DEVELOPERS)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"greygate {__version__}")
        raise typer.Exit()


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


def run() -> None:
    """Entry point: a user's mistake is one line on stderr and exit code 2, Ctrl-C one line and 130, `kill` 143."""
    _stopped.clear()
    signal.signal(signal.SIGTERM, _terminated)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)
    sys.unraisablehook = _ignored
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a path may hold bytes that are no text
    try:
        code = app(standalone_mode=False) or 0
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Exception as error:
        line = "" if _stopped else _mistake(error)  # a library may turn what a signal raises into an error of its own
        if line is None:
            raise
        if line:  # `greygate` alone has printed its help
            say(f"greygate: {line}")
        code = 2
        if _stopped:
            code = INTERRUPTED if isinstance(_stopped[0], KeyboardInterrupt) else TERMINATED
    if code == INTERRUPTED:
        say("greygate: interrupted")
    sys.exit(code)


def _terminated(number: int, frame: object) -> None:
    """Exit through every `finally`, so that temporary files are removed; a second signal ends the process at once."""
    signal.signal(number, signal.SIG_DFL)
    _stopped.append(SystemExit(TERMINATED))
    raise _stopped[-1]


def _interrupted(number: int, frame: object) -> None:
    _stopped.append(KeyboardInterrupt())
    raise _stopped[-1]


def _ignored(error: Any) -> None:
    """Send a Ctrl-C or `kill` again that came while Python ran a callback, whose errors it ignores."""
    number = {KeyboardInterrupt: signal.SIGINT, SystemExit: signal.SIGTERM}.get(error.exc_type)
    if number is None:
        if not _stopped:  # what a signal left half made cannot close itself
            sys.__unraisablehook__(error)
    else:
        if number == signal.SIGTERM:
            signal.signal(number, _terminated)
        later = Timer(AGAIN_S, again, [get_ident(), number])
        later.daemon = True
        later.start()


def _mistake(error: Exception) -> str | None:
    """Return the line that tells the user what to do; None if the error is not a user's mistake."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, UsageError):
        return error.format_message()
    if isinstance(error, MemoryError):
        return "out of memory; give fewer or shorter recordings"
    if isinstance(error, OSError):
        return f"{error.filename or 'a file'}: {error.strerror or error}; check the path, its permissions and the disk"
    return None
