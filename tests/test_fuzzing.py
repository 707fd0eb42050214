"""The process apart that opens mutants tells how each ended."""

import os
import warnings
from contextlib import suppress
from pathlib import Path

import pytest
from fuzzing import MEMORY, Sandbox

from greygate.errors import InputError

pytestmark = pytest.mark.nightly


def write(folder: Path) -> None:
    (folder / "stray").write_text("stray")


def write_and_hide_it(folder: Path) -> None:
    with suppress(BaseException):
        write(folder)


def run_a_shell(folder: Path) -> None:
    os.system("id")


def take_memory(folder: Path) -> None:
    bytearray(2 * MEMORY)


def warn(folder: Path) -> None:
    warnings.warn("this is odd", RuntimeWarning, stacklevel=1)


class Raw(InputError):
    """What the message of an InputError would be if nothing made it one short line."""

    def __init__(self, message: str):
        self.args = (message,)


def refuse_at_length(folder: Path) -> None:
    raise Raw("x" * 1000)


def refuse_in_two_lines(folder: Path) -> None:
    raise Raw("one\ntwo")


def crash(folder: Path) -> None:
    os.abort()


def hang(folder: Path) -> None:
    9**9**9  # no signal ends it


def accept(folder: Path) -> None:
    assert (folder / "deep" / "file").read_bytes() == b"1"


def test_the_process_apart_tells_every_ending_that_is_not_permitted():
    box = Sandbox(patience=2.0)
    endings = {
        accept: "accepted",
        write: "escape",
        write_and_hide_it: "escape",
        run_a_shell: "escape",
        take_memory: "MemoryError in ?",
        warn: "RuntimeWarning in ?",
        refuse_at_length: "long message",
        refuse_in_two_lines: "message with control characters",
        crash: "crash",
        hang: "hang",
    }
    found = {entrance: box.open(entrance, {"deep/file": b"1"}).kind for entrance in endings}
    again = box.open(accept, {"deep/file": b"1"})
    box.close()
    assert found == endings
    assert again.permitted
