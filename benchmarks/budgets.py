"""What `greygate identify` finds in 5, 20, 60 and 300 s of the processor, and for what there was no time.

Five measured recordings; errors over test runs beside those of the best linear model that it had by then.
"""

from functools import partial

from benchmarks.identify import found_by

TAKES = "twenty minutes"
NAMES = ("tanks", "ced", "crane", "emps", "mts")
SECONDS = (5.0, 20.0, 60.0, 300.0)
KEPT = ("chosen", "tests", "unit", "linear_model", "linear_held_out", "tried", "untried", "seconds")


def found_in(name: str) -> dict:
    found = {f"{seconds:g}": found_by(name, seconds) for seconds in SECONDS}
    return {seconds: {key: of[key] for key in KEPT} for seconds, of in found.items()}


PARTS = {name: partial(found_in, name) for name in NAMES}
