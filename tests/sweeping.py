"""One test over many cases: each is tried, and all that fail are told together, by name."""

from collections.abc import Callable, Iterable
from traceback import extract_tb

import pytest

FAILURES = (Exception, pytest.fail.Exception)  # the second is that of `pytest.raises` where nothing is raised


def every(cases: Iterable, check: Callable, name: Callable[..., str] = repr) -> None:
    """Call `check` with each case; a tuple gives its arguments.

    Fails if there is no case, and with the name, the line and the error of every case that fails.
    """
    cases, failed = list(cases), []
    for case in cases:
        try:
            check(*case) if isinstance(case, tuple) else check(case)
        except FAILURES as error:
            failed.append(f"{name(case)}: line {extract_tb(error.__traceback__)[-1].lineno}: {told(error)}")
    assert cases, "no case to try"
    assert not failed, f"{len(failed)} of {len(cases)} fail:\n" + "\n".join(failed)


def told(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
