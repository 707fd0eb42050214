"""What columns of a linearised fit save on stretches of a recording to which their coefficients were not fitted."""

from dataclasses import dataclass

import numpy as np

from greygate.mismatch.fit import HELD, Fit, flattened
from greygate.mismatch.model import TINY

RIDGE = 1e-6  # of a column's own square, which keeps the normal matrix of columns that are nearly alike regular


@dataclass(frozen=True)
class Halves:
    """Normal matrices and right sides of all columns over alternate stretches, scaled; k come from the base."""

    gram: np.ndarray  # (2, n, n)
    pull: np.ndarray  # (2, n)
    k: int

    @classmethod
    def of(cls, base: Fit, columns: np.ndarray) -> "Halves":
        k = len(base.unknowns)
        both = np.concatenate([base.slopes, columns], axis=2)
        even = base.likelihood.turns(HELD, 2) == 0
        gram, pull = [], []
        for half in (even, ~even):
            flat, e = flattened(both[half]), base.projected[half].reshape(-1)
            g, p = flat.T @ flat, -(flat.T @ e)
            g[np.diag_indices(k)] += base.weight / 2
            p[:k] -= base.weight * base.numbers / 2
            gram.append(g)
            pull.append(p)
        scale = np.sqrt(np.maximum(np.diag(gram[0] + gram[1]), TINY))
        return cls(np.array(gram) / np.outer(scale, scale), np.array(pull) / scale, k)

    def saved(self, chosen: list[int]) -> float:
        """Cost that the chosen columns save on the half that their coefficients were not fitted to, both ways."""
        use = [*range(self.k), *chosen]
        total = 0.0
        for learn, judge in ((0, 1), (1, 0)):
            g = self.gram[learn][np.ix_(use, use)] + RIDGE * np.eye(len(use))
            step = np.linalg.solve(g, self.pull[learn][use])
            total += float(2 * self.pull[judge][use] @ step - step @ self.gram[judge][np.ix_(use, use)] @ step)
        return total
