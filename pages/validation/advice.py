"""What to do about a network that does not pass: sentences for the terminal."""

import numpy as np

from greygate.models.accuracy import rms
from greygate.models.residuals import asks_for
from greygate.models.validation import Validation
from greygate.pages.validation.judged import Judged

STARTS = (10, 20, 50, 100, 200, 500, 1000)  # samples of a beginning that are offered as --settle
LOUD = 3.0  # times the later residual, from which a beginning is taken to settle
QUIET = 1.5  # times the later residual, below which the state has settled
LATER = 0.5  # share of a record at its end, to which its beginning is compared


def advice(judged: Judged) -> list[str]:
    """What to do, a sentence each; first what matters most."""
    return list(dict.fromkeys(line for v in judged.validations for line in _of(v)))


def _of(v: Validation) -> list[str]:
    where = f"{v.output} on {v.record}"
    found = []
    if not v.bounded:
        found.append(
            f"{where}: the free run leaves what was measured; train in free run (not one step ahead alone), with more "
            "--decay, longer records, or linear_loop=True"
        )
    elif not v.long_run.stable:
        found.append(f"{where}: the error grows with each repetition; take the offset off the inputs, or measure more")
    if (settle := settling(v)) is not None:
        samples, ratio = settle
        found.append(
            f"{where}: residuals of the first {samples} samples are {ratio:.0f} times the rest: --settle {samples}"
        )
    residual = "free run" if "one step ahead" not in v.tests else "one step ahead"
    for test in v.tests.get(residual, ()):
        if not test.passed:
            found.append(f"{where}, {residual}: {asks_for(test, v.output)}")
    return found


def settling(v: Validation) -> tuple[int, float] | None:
    """Samples at the beginning of a record whose residual is far larger than later, and by how much; None if not."""
    e = (v.measured - v.predicted)[v.skip :]
    later = rms(e[int(LATER * len(e)) :])
    if v.skip or not (np.isfinite(later) and later > 0):
        return None
    for samples in STARTS:
        if samples > len(e) // 5:
            return None
        if rms(e[samples : 2 * samples]) <= QUIET * later:
            ratio = rms(e[:samples]) / later
            return (samples, ratio) if ratio > LOUD else None
    return None
