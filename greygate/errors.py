"""The one exception that a user's mistake raises, and how its message shows what was given."""

import reprlib
from collections.abc import Iterator
from contextlib import contextmanager

LONGEST = 480  # characters of a message: about six lines of a terminal
SHOWN = 60  # characters of a wrong value that a message repeats

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxstring, _SHORT.maxlong, _SHORT.maxother = 3, SHOWN, SHOWN, SHOWN


class InputError(ValueError):
    """Something the user gave is wrong. The message is one line: what, where, what to do.

    What the message quotes from a file may hold anything: characters that do not print are escaped, and a message
    that is too long loses its middle. The command line prints it to stderr and exits with 2; nothing has been written
    by then.

    >>> emulate(program, {"u": np.array([np.nan])})
    Traceback (most recent call last):
    greygate.errors.InputError: input u: a value is not finite; repair the recording
    """

    def __init__(self, message: str):
        line = one_line(str(message))
        half = LONGEST // 2 - 2  # the head says where, the tail what to do
        super().__init__(line if len(line) <= LONGEST else f"{line[:half]} … {line[-half:]}")


@contextmanager
def brought_by(extra: str, *packages: str) -> Iterator[None]:
    """Import such packages in the block; where one is not installed, the InputError says which extra brings it."""
    try:
        yield
    except ImportError as error:
        if error.name not in packages:
            raise
        raise InputError(f"{error.name} is not installed; pip install 'greygate[{extra}]'") from None


def one_line(text: str) -> str:
    """The text with every character that cannot be seen (ends of lines, controls, marks of direction) as its escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shown(value: object) -> str:
    """A value that may be anything, as a message repeats it: quoted, and not long."""
    try:
        text = _SHORT.repr(value)
    except ValueError:  # more digits than Python writes
        return "(a huge number)"
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."
