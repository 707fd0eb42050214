"""What networks are made of: ports, layers and connections."""

from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from greygate.models.activations import ACTIVATIONS, Activation, known

LONGEST_DELAY = 500  # steps
LARGEST_SIZE = 4096  # signals of a port, neurons of a layer


@dataclass(frozen=True)
class Port:
    """Where a signal enters or leaves a network: inside stands (value - offset) / scale.

    value: `unit` (SI). `initial`: what the port carried before the first step, in `unit`. `resolution`: of the sensor,
    in `unit`, 0 if it is not known; the hardware's input codes are then no coarser and no finer.

    >>> u, y = Port("u", "V", scale=2.0), Port("y", "m", scale=1e-3)
    >>> u.scale  # what 2 V are inside: 1
    2.0
    """

    name: str
    unit: str = "1"
    scale: float = 1.0
    offset: float = 0.0
    size: int = 1
    initial: float = 0.0
    resolution: float = 0.0

    def normalised(self, value):
        """What stands inside for a value (number or array) in `unit`."""
        return (value - self.offset) / self.scale

    @property
    def labels(self) -> list[str]:
        """Names of its elements: its own, or `name[0]`, `name[1]`, ... where there are several."""
        return [self.name] if self.size == 1 else [f"{self.name}[{i}]" for i in range(self.size)]

    @property
    def rest(self) -> float:
        """What stands inside before step 0."""
        return self.normalised(self.initial)


@dataclass(frozen=True, init=False)
class Layer:
    """activation(sum_p weights[p] @ input_p + bias). Raises InputError for an activation that does not exist.

    weights: port -> (rows, n). bias: (rows,). initial: (size,), its output before the first step. A neuron is a row;
    only `select`, a multiplexer, has three rows a neuron, and `product` two (`models.activations`).
    frozen: names of ports (or "bias") that training leaves as they are.

    >>> memory = Layer({"u": [[0.08]], "y": [[0.9]]}, [0.0])
    >>> memory.size, memory.activation
    (1, 'linear')
    """

    weights: dict[str, np.ndarray]
    bias: np.ndarray
    activation: str
    initial: np.ndarray
    frozen: frozenset[str]

    def __init__(
        self,
        weights: Mapping[str, ArrayLike],
        bias: ArrayLike,
        activation: str = "linear",
        initial: ArrayLike = 0.0,
        frozen: Set[str] = frozenset(),
    ):
        given = self.__dict__  # a frozen instance takes its values there
        given["activation"] = known(activation, "layer:")
        given["bias"] = np.atleast_1d(np.asarray(bias, float))
        given["weights"] = {p: np.atleast_2d(np.asarray(w, float)) for p, w in weights.items()}
        given["initial"] = np.broadcast_to(np.asarray(initial, float), self.size)
        given["frozen"] = frozenset(frozen)

    @property
    def rows(self) -> int:
        """Sums that it forms."""
        return len(self.bias)

    @property
    def size(self) -> int:
        """Neurons, which are its outputs."""
        return len(self.bias) // self.function.rows

    @property
    def function(self) -> Activation:
        """All there is to know of its activation."""
        return ACTIVATIONS[self.activation]

    @property
    def is_linear(self) -> bool:
        return self.function.lowered == "affine"


@dataclass(frozen=True)
class Connection:
    """target(k) receives gain @ source(k - delay). Names: `port`, `module` or `module.port`.

    >>> feedback = Connection("memory", "memory.y", delay=1)
    >>> feedback.delay
    1
    """

    source: str
    target: str
    delay: int = 0
    gain: float | np.ndarray | None = None
