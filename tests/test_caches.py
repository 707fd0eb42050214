"""Where compiled code is kept, for a user who can write neither the package nor a home."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from checking import POSIX

from greygate import caches, system

NOBODY = 65534


def root() -> bool:
    return hasattr(os, "getuid") and os.getuid() == 0


@pytest.fixture
def temporary(tmp_path, monkeypatch) -> Path:
    """No home; the folder for temporary files."""
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null/none")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path / f"greygate-{system.user()}"


@POSIX
def test_without_a_home_it_is_a_temporary_folder_of_the_user_alone(temporary):
    assert caches.folder() == temporary
    assert temporary.stat().st_mode & 0o777 == 0o700
    assert caches.folder() == temporary


@POSIX
@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_can_write_is_not_used(temporary, mode):
    temporary.mkdir()
    temporary.chmod(mode)
    assert caches.folder() is None


@POSIX
def test_a_link_in_its_place_is_not_followed(temporary, tmp_path):
    (tmp_path / "other").mkdir(mode=0o700)
    temporary.symlink_to(tmp_path / "other")
    assert caches.folder() is None


@POSIX
@pytest.mark.skipif(not root(), reason="only root can give a folder away")
def test_a_folder_of_another_user_is_not_used(temporary):
    temporary.mkdir(mode=0o700)
    os.chown(temporary, NOBODY, NOBODY)
    assert caches.folder() is None


@POSIX
@pytest.mark.skipif(not root() or not shutil.which("setpriv"), reason="needs root and setpriv")
def test_a_user_who_can_write_neither_package_nor_home_has_numba_keep_its_code(tmp_path):
    """Nobody may read everything here, since the tests may lie in root's home, and write almost nothing."""
    tmp_path.chmod(0o777)
    who = [f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    may = ["--inh-caps", "+dac_read_search", "--ambient-caps", "+dac_read_search"]
    told = "from greygate.models.arithmetic import _exp; _exp(0.0)"
    environment = {n: v for n, v in os.environ.items() if n not in ("XDG_CACHE_HOME", caches.NUMBA)}
    environment |= {"HOME": "/nonexistent", "TMPDIR": str(tmp_path)}
    command = ["setpriv", *who, *may, sys.executable, "-P", "-c", told]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if "setpriv:" in done.stderr:
        pytest.skip(f"this machine lets no user have that right: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    kept = tmp_path / f"greygate-{NOBODY}"
    assert (kept.stat().st_uid, kept.stat().st_mode & 0o777) == (NOBODY, 0o700)
    assert list((kept / "numba").rglob("*.nbi"))
