"""What a recording says for an effect where its fit did not look: a split e-value, and how many names it bears.

The recording is cut into stretches, by turns in one half or the other. The hypothesis learns from one half and is
judged on the other. The same without the effect is judged there too, with what parameters serve it best on that very
half. Where the effect is not there, the ratio of the two likelihoods is 1 on average at most, whatever was learnt: an
e-value (Wasserman, Ramdas, Balakrishnan: Universal inference, 2020). That of the recording is the mean of both halves'.

Of m candidates K may be named whose e-values are all m / (K FALSE) or more: then at most a share FALSE of all names is
wrong in the long run, however the candidates depend on each other (e-BH, Wang and Ramdas, 2022).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from greygate.mismatch.coloured import Coloured
from greygate.mismatch.fit import HELD, Fit

FALSE = 0.02  # of all names may be wrong
LARGEST = 1e300  # of an e-value that a file shows


@dataclass(frozen=True)
class Evidence:
    """log_e: natural logarithm of the e-value. gain: of -2 log likelihood on the unseen halves, both together."""

    log_e: float
    gain: float

    def __str__(self) -> str:
        return f"e^{self.log_e:.3g}"

    def as_dict(self) -> dict[str, float]:
        e_value = LARGEST if self.log_e > np.log(LARGEST) else float(np.exp(self.log_e))
        return {"e_value": e_value, "held_out_gain": self.gain}


def evidence(without: Fit, fit: Fit, wider: float = 1.0) -> Evidence:
    """The evidence of `fit` for what `without` has not.

    wider: the factor by which errors that depend on each other widen the variance of what is found.
    """
    half = fit.likelihood.alternate(HELD)
    gains = []
    for learn in (half, ~half):
        gains.append(without.judged(~learn, ~learn) - fit.judged(learn, ~learn))
        if isinstance(fit.likelihood, Coloured) and isinstance(without.likelihood, Coloured):
            more = without.likelihood.deviance() - fit.likelihood.deviance()
            gains[-1] += more * float(np.mean(~learn))
    halves = np.array(gains) / 2 / wider
    top = float(halves.max())
    if not np.isfinite(top):
        return Evidence(-np.inf if top < 0 or np.isnan(top) else np.inf, float(np.sum(gains)))
    return Evidence(top + float(np.log(np.mean(np.exp(halves - top)))), float(np.sum(gains)))


def borne_out(found: Mapping[str, Evidence], candidates: int) -> set[str]:
    """Of those found, the largest set that may be named together. candidates: that might have been found."""
    ranked = sorted(found, key=lambda name: -found[name].log_e)
    for count in range(len(ranked), 0, -1):
        if found[ranked[count - 1]].log_e >= np.log(candidates / (count * FALSE)):
            return set(ranked[:count])
    return set()
