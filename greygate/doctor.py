"""Looks for what the commands need on this machine: programs, and the packages of each extra."""

import re
import shutil
from dataclasses import dataclass
from importlib import metadata

from greygate import children

PATIENCE = 20.0  # s that a program may take to say its version
PROGRAMS = {  # program -> (the commands that need it, how to get it)
    "g++": ("verify, prove, play", "install a C++ compiler: apt-get install g++"),
    "make": ("verify, prove, play", "apt-get install make"),
    "perl": ("verify, prove, play", "apt-get install perl"),
}
OWN = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^]]*\])?([^;]*)(?:;\s*extra\s*==\s*['\"]([^'\"]+)['\"])?\s*$")


@dataclass(frozen=True)
class Tool:
    """One program or package.

    version: as it says itself; None if it is missing. needed_by: commands, or the extra that brings it.
    needed: whether a command of the plain installation fails without it. remedy: how to get it.
    """

    name: str
    version: str | None
    needed_by: str
    needed: bool
    remedy: str


def tools() -> list[Tool]:
    """Every program and package that greygate uses, found or missing."""
    return [*(_program(name, *told) for name, told in PROGRAMS.items()), *_packages()]


def _program(name: str, needed_by: str, remedy: str) -> Tool:
    path = shutil.which(name)
    said = None if path is None else _said(path)
    return Tool(name, said, needed_by, True, remedy)


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
