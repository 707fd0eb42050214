"""constraints.txt is what a newcomer's `make demo` installs from the public index."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PINS = dict(
    line.split("==") for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if line.strip()
)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


PINNED = {canonical(name): version for name, version in PINS.items()}


def required(requirements: list[str]) -> list[str]:
    """Names, without versions and without what only an extra or a platform needs (torch's CUDA on Linux)."""
    return [canonical(re.match(r"[\w.-]+", r)[0]) for r in requirements if not re.search(r"extra ==|platform_", r)]


@pytest.mark.parametrize("name", PINS)
def test_a_pin_is_one_public_version_which_the_index_has(name):
    """`torch==2.13.0+cpu` is on no public index: a local version is that of one builder (PEP 440)."""
    assert re.fullmatch(r"\d+(\.\d+)*((a|b|rc)\d+)?(\.post\d+)?", PINS[name]), f"{name}=={PINS[name]}"


def test_every_dependency_is_pinned_and_so_is_every_dependency_of_it_that_is_installed():
    """Each from the project's own list, extras too; a distribution that is not here is not needed here."""
    extras = [r for extra in PROJECT["optional-dependencies"].values() for r in extra]
    own = [*PROJECT["dependencies"], *(r for r in extras if not r.startswith("greygate["))]
    waiting, seen = required(own), set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        try:
            found = distribution(name)
        except PackageNotFoundError:
            continue
        assert name in PINNED or name in UNPINNED, f"{name} {found.version} is installed and not pinned"
        waiting += required(found.requires or [])
    assert set(required(own)) <= PINNED.keys()


UNPINNED = {"setuptools"}  # comes with the virtual environment


def test_what_is_installed_is_what_is_pinned():
    """A pin that nobody runs is a guess. The public part counts: torch from its own index is `2.13.0+cpu`."""
    differing = {}
    for name, version in PINNED.items():
        try:
            installed = distribution(name).version.partition("+")[0]
        except PackageNotFoundError:
            continue
        if installed != version:
            differing[name] = (installed, version)
    assert not differing
