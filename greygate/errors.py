"""The one exception that a user's mistake raises."""

LONGEST = 480  # characters of a message: about six lines of a terminal


class InputError(ValueError):
    """Something the user gave is wrong. The message is one line: what, where, what to do.

    What the message quotes from a file may hold anything: characters that do not print are escaped, and a message
    that is too long loses its middle. The command line prints it to stderr and exits with 2; nothing has been written
    by then.
    """

    def __init__(self, message: str):
        super().__init__(_one_line(str(message)))


def _one_line(text: str) -> str:
    line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    if len(line) <= LONGEST:
        return line
    half = LONGEST // 2 - 2  # the head says where, the tail what to do
    return f"{line[:half]} … {line[-half:]}"
