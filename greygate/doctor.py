"""Looks for what the commands need on this machine: its system, programs, and the packages of each extra."""

import re
import shutil
import sys
from dataclasses import dataclass
from importlib import metadata

from greygate import children, system
from greygate.foreign.child import UNLIMITED

PATIENCE = 20.0  # s that a program may take to say its version
NEED = "verify, prove, play"  # the commands that run a simulation of the hardware
PROGRAMS = ("g++", "make", "perl")
GET = {  # system -> how a program comes there
    "linux": "apt-get install {}", "darwin": "xcode-select --install", "win32": "install {} with MSYS2, or use WSL",
}  # fmt: skip
TRIED = "linux"  # where the tests have run
OTHERS = "recordings in .mat .h5 .parquet .mdf .tdms .mcap"
PROBE = "from greygate.system import limit; print(limit(1 << 28, 60, 1 << 20))"
OWN = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^]]*\])?([^;]*)(?:;\s*extra\s*==\s*['\"]([^'\"]+)['\"])?\s*$")


@dataclass(frozen=True)
class Tool:
    """One program or package, or something that the system does.

    version: as it says itself; None if it is missing. needed_by: commands, or the extra that brings it.
    needed: whether a command of the plain installation fails without it. remedy: how to get it.
    """

    name: str
    version: str | None
    needed_by: str
    needed: bool
    remedy: str


def tools() -> list[Tool]:
    """Every program and package that greygate uses, found or missing, and what the system does or does not."""
    return [*_system(), *map(_program, PROGRAMS), *_packages()]


def _system() -> list[Tool]:
    locks = "held" if system.LOCKS else None
    bound = children.ran(children.python("-c", PROBE), timeout=PATIENCE).stdout.strip() == "True"
    tried = sys.platform if sys.platform == TRIED else None
    return [
        Tool(
            "system",
            tried,
            "every command",
            False,
            f"untried on {sys.platform}: where a command fails, use Linux or WSL",
        ),
        Tool("file locks", locks, "every command", True, system.NO_LOCKS),
        Tool(
            "memory limits",
            "held" if bound else None,
            OTHERS,
            False,
            f"save as CSV, or set {UNLIMITED}=1 for files that you trust",
        ),
    ]


def _program(name: str) -> Tool:
    path = shutil.which(name)
    said = None if path is None else _said(path)
    return Tool(name, said, NEED, True, GET.get(sys.platform, GET[TRIED]).format(name))


def _said(path: str) -> str:
    """The version that a program prints, or "found"."""
    try:
        done = children.ran([path, "--version"], timeout=PATIENCE)
    except (OSError, children.TimeoutExpired):
        return "found, does not answer"
    number = re.search(r"\d+(\.\d+)+", done.stdout + done.stderr)
    return number[0] if number else "found"


def _packages() -> list[Tool]:
    """The packages that the installed greygate asks for, in the order of its own list."""
    found = []
    for requirement in metadata.requires("greygate") or []:
        if (told := OWN.match(requirement)) is None:
            continue
        name, _, extra = told.groups()
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            version = None
        wanted = f"greygate[{extra}]" if extra else "greygate"
        found.append(
            Tool(name, version, f"extra {extra}" if extra else "every command", not extra, f"pip install '{wanted}'")
        )
    return found
