"""A sweep fails with every case that fails, and where it has none."""

import re

import pytest
from sweeping import every


def even(number: int) -> None:
    assert number % 2 == 0, "odd"


def test_a_sweep_tries_every_case_and_tells_all_that_fail():
    tried = []
    with pytest.raises(AssertionError) as failed:
        every([2, 3, 4, 5], lambda number: (tried.append(number), even(number)))
    assert tried == [2, 3, 4, 5]
    assert str(failed.value).startswith("2 of 4 fail:\n3: line ")
    assert re.findall(r"(?m)^(\d+): line \d+: AssertionError: odd$", str(failed.value)) == ["3", "5"]
    every([2, 4], even)


def test_a_sweep_tells_of_an_error_that_is_missing_and_of_one_that_is_none_of_its_own():
    def refused(number: int) -> None:
        with pytest.raises(ValueError, match="zero"):
            1 // number

    with pytest.raises(AssertionError, match=r"1: line \d+: Failed: DID NOT RAISE") as failed:
        every([1, 0], refused)
    assert "0: line" in str(failed.value)
    assert "ZeroDivisionError" in str(failed.value)


def test_a_sweep_of_nothing_fails():
    with pytest.raises(AssertionError, match="no case"):
        every([], even)
