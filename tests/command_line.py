"""The command `greygate` in this process: a process of its own takes two seconds to import what a command needs."""

import sys
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from io import BytesIO, TextIOWrapper

import pytest
from typer.main import get_command

from greygate import cli, progress

built = cache(get_command)  # of all commands, which takes as long as a refusal


def greygate(*arguments) -> tuple[int, str, str]:
    """Exit code, stdout, stderr. What is said once in a process is said again."""
    progress._SAID.clear()
    out, error = (TextIOWrapper(BytesIO(), "utf-8", newline="", write_through=True) for _ in range(2))
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(error):
        patch.setattr(sys, "argv", ["greygate", *map(str, arguments)])
        patch.setattr(cli, "app", built(cli.app))
        with pytest.raises(SystemExit) as stopped:
            cli.run()
    return stopped.value.code, *(stream.buffer.getvalue().decode() for stream in (out, error))
