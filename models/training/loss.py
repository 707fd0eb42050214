"""The loss of a training: squared errors on its records, decay of the weights, and parts that are rehearsed."""

from collections.abc import Mapping

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Network
from greygate.models.training.objective import Objective

Decay = float | Mapping[str, float | np.ndarray]  # of all weights, or by module, layer or parameter


class Loss:
    """J = (1/2N) (sum e^2 + theta' D theta), and the same for modules on records of their own, over one theta.

    objective: of the network on its records. decay: of the weights, rehearse: {module: record}, both as for `train`.
    Raises InputError for a name that the network does not have and a decay that is negative or not finite.
    """

    def __init__(self, objective: Objective, network: Network, decay: Decay, rehearse: Mapping):
        self.objective = objective
        self.decay = self._decay(decay)
        self.parts = []
        place = objective.slices()
        for path, record in rehearse.items():
            part = Objective(_module(network, path), [record])
            index = np.concatenate([place[f"{path}.{n}"] for n in part.slices()])
            moving = np.flatnonzero(objective.variable[index[part.free]] >= 0)
            self.parts.append((part, index, moving, objective.variable[index[part.free]][moving]))

    def _decay(self, decay: Decay) -> np.ndarray:
        """D's diagonal over the variables; initial states do not decay."""
        place, shapes = self.objective.slices(), self.objective.shapes
        size = sum(map(len, place.values()))
        diagonal = np.zeros(len(self.objective.theta))
        if not isinstance(decay, Mapping):
            diagonal[:size] = decay
        else:
            for name in decay:
                if name not in place and not any(n.startswith(name + ".") for n in place):
                    raise InputError(f"decay names {name}, which is no module, layer or parameter of the network")
            for parameter, columns in place.items():  # the longest name that fits counts
                fits = [d for d in decay if parameter == d or parameter.startswith(d + ".")]
                if not fits:
                    continue
                given = np.asarray(decay[name := max(fits, key=len)], float)
                if given.ndim and (name != parameter or given.shape != shapes[parameter]):
                    raise InputError(
                        f"decay of {name} has the shape {given.shape}; give one number, or an array of a parameter's "
                        f"shape ({parameter}: {shapes[parameter]})"
                    )
                diagonal[columns] = given.ravel()
        if not ((diagonal >= 0) & np.isfinite(diagonal)).all():
            worst = diagonal[~((diagonal >= 0) & np.isfinite(diagonal))][0]
            raise InputError(f"decay {worst}: give finite numbers from 0 on; a negative one rewards large weights")
        return diagonal[self.objective.free]

    def __call__(self, theta: np.ndarray) -> float:
        """J = (1/2N) (sum e^2 + rehearsal's weighted sum e^2 + theta' D theta); inf where a run diverges."""
        squares = self.objective.squares(theta) + sum(part.squares(theta[index]) for part, index, _, _ in self.parts)
        if self.decay.any():
            squares += float(self.decay @ theta[self.objective.free] ** 2)
        return squares / (2 * self.objective.samples)

    def normal_equations(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        hessian, gradient = self.objective.normal_equations(theta)
        for part, index, moving, where in self.parts:
            h, g = part.normal_equations(theta[index])
            np.add.at(hessian, np.ix_(where, where), h[np.ix_(moving, moving)])
            np.add.at(gradient, where, g[moving])
        hessian.ravel()[:: len(hessian) + 1] += self.decay
        return hessian, gradient + self.decay * theta[self.objective.free]


def _module(network: Network, path: str) -> Network:
    for name in path.split("."):
        module = network.modules.get(name)
        if not isinstance(module, Network):
            raise InputError(f"cannot rehearse {path}: {name} is not a network with ports of its own")
        network = module
    return network
