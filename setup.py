"""The packages of greygate: every folder of code in the folders that pyproject.toml names; none is listed by hand."""

import tomllib
from pathlib import Path

from setuptools import find_packages, setup

FOLDERS = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-dir"]

setup(
    packages=[
        f"{package}{inner}"
        for package, folder in FOLDERS.items()
        for inner in ("", *(f".{name}" for name in find_packages(folder)))
    ]
)
