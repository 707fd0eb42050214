"""What a recording says for an effect where its fit did not look: an e-value, and how many names it bears.

The recording is cut into stretches, by turns in one half or the other (or in one of five parts, where halves teach too
little). The hypothesis learns from the rest and is judged on a part k, against the same without the effect, which has
learnt from all:

    E = mean_k exp((D0_k - D1_k) / (2 wider)),    D = -2 log likelihood of part k

Where the effect is not there, E is 1 on average at most, whatever was learnt: an e-value (Wasserman, Ramdas,
Balakrishnan: Universal inference, 2020).

Of m candidates K may be named whose e-values are all m / (K FALSE) or more: then at most a share FALSE of all names is
wrong in the long run, however the candidates depend on each other (e-BH, Wang and Ramdas, 2022).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from greygate.mismatch.coloured import Coloured
from greygate.mismatch.fit import HELD, Fit

FALSE = 0.02  # of all names may be wrong
FOLDS, REFIT = 5, 8  # parts of an exact judgement; iterations of a fit without one, which begins at that to all
LARGEST = 1e300  # of an e-value that a file shows


@dataclass(frozen=True)
class Evidence:
    """log_e: natural logarithm of the e-value. gain: of -2 log likelihood on the unseen halves, both together.

    least: natural logarithm of the likelihood ratio of the part that says least for it.
    """

    log_e: float
    gain: float
    least: float = 0.0

    def __str__(self) -> str:
        return f"e^{self.log_e:.3g}"

    def as_dict(self) -> dict[str, float]:
        e_value = LARGEST if self.log_e > np.log(LARGEST) else float(np.exp(self.log_e))
        return {"e_value": e_value, "held_out_gain": self.gain}


def evidence(without: Fit, fit: Fit, wider: float = 1.0, exact: bool = False) -> Evidence:
    """The evidence of `fit` for what `without` has not.

    wider: the factor by which errors that depend on each other widen the variance of what is found. exact: the
    hypothesis is fitted in full to all but a fifth, which judges it, for each fifth in turn; else to each half by one
    linearised step from its fit to both.
    """
    likelihood = fit.likelihood
    turns = likelihood.turns(HELD, FOLDS if exact else 2)
    parts = [turns == k for k in np.unique(turns)]
    gains = np.array([_before(without, judge) - unseen(fit, ~judge, judge, exact) for judge in parts])
    logs = gains / 2 / wider
    top = float(logs.max())
    if not np.isfinite(top):
        return Evidence(np.inf if top > 0 else -np.inf, float(np.sum(gains)), float(logs.min()))
    return Evidence(top + float(np.log(np.mean(np.exp(logs - top)))), float(np.sum(gains)), float(logs.min()))


def unseen(fit: Fit, learn: np.ndarray, judge: np.ndarray, exact: bool = False) -> float:
    """-2 log likelihood of the windows `judge` (windows,) of bool, with the parameters that `learn` alone give."""
    if not exact:
        return fit.judged(learn, judge) + _deviance(fit, judge)
    likelihood = fit.likelihood
    held = np.zeros(len(likelihood.sigma), bool)
    held[likelihood.kept] = np.repeat(judge, likelihood.block)
    values = fit.without(held, REFIT)
    numbers = np.array([u.number(values[u.symbol]) for u in fit.unknowns])
    return _before(replace(fit, numbers=numbers, errors=likelihood.errors(values, fit.shifts)), judge)


def _before(fit: Fit, judge: np.ndarray) -> float:
    """The same with the parameters of the fit to all."""
    return float(np.sum(fit.projected[judge] ** 2)) + _deviance(fit, judge)


def _deviance(fit: Fit, judge: np.ndarray) -> float:
    likelihood = fit.likelihood
    return likelihood.deviance() * float(np.mean(judge)) if isinstance(likelihood, Coloured) else 0.0


def borne_out(found: Mapping[str, Evidence], candidates: int) -> set[str]:
    """Of those found, the largest set that may be named together. candidates: that might have been found.

    A part that speaks against a name as much as would bear one refutes it, however lucky the others are.
    """
    ranked = sorted((name for name in found if found[name].least > np.log(FALSE)), key=lambda n: -found[n].log_e)
    for count in range(len(ranked), 0, -1):
        if found[ranked[count - 1]].log_e >= np.log(candidates / (count * FALSE)):
            return set(ranked[:count])
    return set()
