"""The one exception that a user's mistake raises."""


class InputError(ValueError):
    """Something the user gave is wrong. The message is one line: what, where, what to do.

    The command line prints it to stderr and exits with 2; nothing has been written by then.
    """
