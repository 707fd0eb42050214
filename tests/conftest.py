"""What several test files share."""

import sys

import pytest

from greygate import cli


@pytest.fixture
def greygate(monkeypatch, capsys):
    """The command: exit code, stdout, stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["greygate", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            cli.run()
        return stopped.value.code, *capsys.readouterr()

    return run
