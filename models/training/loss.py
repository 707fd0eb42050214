"""The loss of a training: squared errors on its records, decay of the weights, and parts that are rehearsed."""

from collections.abc import Mapping

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.training.objective import Objective


class Loss:
    """A network on its records, with decay, and modules of it on records of their own, over one theta."""

    def __init__(self, main: Objective, network: Network, decay: float | Mapping[str, float], rehearse: Mapping):
        self.main = main
        self.decay = self._decay(decay)
        self.parts = []
        place = main.slices()
        for path, record in rehearse.items():
            part = Objective(_module(network, path), [record])
            index = np.concatenate([place[f"{path}.{n}"] for n in part.slices()])
            moving = np.flatnonzero(main.variable[index[part.free]] >= 0)
            self.parts.append((part, index, moving, main.variable[index[part.free]][moving]))

    def _decay(self, decay: float | Mapping[str, float]) -> np.ndarray:
        """D's diagonal over the variables; initial states do not decay."""
        place = self.main.slices()
        size = sum(map(len, place.values()))
        diagonal = np.zeros(len(self.main.theta))
        if not isinstance(decay, Mapping):
            diagonal[:size] = decay
        else:
            for name in decay:
                if name not in place and not any(n.startswith(name + ".") for n in place):
                    raise InputError(f"decay names {name}, which is no module, layer or parameter of the network")
            for name, columns in place.items():  # the longest name that fits counts
                fits = [d for d in decay if name == d or name.startswith(d + ".")]
                diagonal[columns] = decay[max(fits, key=len)] if fits else 0.0
        if not ((diagonal >= 0) & np.isfinite(diagonal)).all():
            raise InputError(f"decay {decay}: give finite numbers from 0 on; a negative one rewards large weights")
        return diagonal[self.main.free]

    def loss(self, theta: np.ndarray) -> float:
        """J = (1/2N) (sum e^2 + rehearsal's weighted sum e^2 + theta' D theta); inf where a run diverges."""
        squares = self.main.squares(theta) + sum(part.squares(theta[index]) for part, index, _, _ in self.parts)
        if self.decay.any():
            squares += float(self.decay @ theta[self.main.free] ** 2)
        return squares / (2 * self.main.samples)

    def normal_equations(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        hessian, gradient = self.main.normal_equations(theta)
        for part, index, moving, where in self.parts:
            h, g = part.normal_equations(theta[index])
            np.add.at(hessian, np.ix_(where, where), h[np.ix_(moving, moving)])
            np.add.at(gradient, where, g[moving])
        hessian.ravel()[:: len(hessian) + 1] += self.decay
        return hessian, gradient + self.decay * theta[self.main.free]


def _module(network: Network, path: str) -> Network:
    for name in path.split("."):
        network = getattr(network, "modules", {}).get(name)
        if not isinstance(network, Network):
            raise InputError(f"cannot rehearse {path}: {name} is not a network with ports of its own")
    return network
