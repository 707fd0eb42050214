"""A function that is asked the same question a few times in a row: by those who count, write and prove a design."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Answer = TypeVar("Answer")


def lately(function: Callable[Given, Answer]) -> Callable[Given, Answer]:
    """Keep the last answer. A program has no hash, so the first argument is compared by identity.

    >>> @lately
    ... def doubled(numbers, times):
    ...     return numbers * 2 * times
    >>> one = [1]
    >>> doubled(one, 1) is doubled(one, 1)
    True
    >>> doubled(one, 2)
    [1, 1, 1, 1]
    """
    last: list = []

    @wraps(function)
    def asked(*given: Given.args, **named: Given.kwargs) -> Answer:
        if not last or last[0] is not given[0] or last[1] != (given[1:], named):
            answer = function(*given, **named)
            last[:] = given[0], (given[1:], named), answer
        return last[2]

    return asked
