"""What the augmentation of a plant's structured network is made of: the law that a module learns, and the network.

A machine's folder has a class, an `Augmentation`, for each plant of it whose network mismatch/augment.py can augment.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from greygate.mismatch.rig import Channel, Rig
from greygate.models.families.blocks import feedforward
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.plants.recording import Recording

HIDDEN, SEED, EPOCHS, DECAY = 5, 0, 200, 1e-6  # of a module, while it is taught its law
ROOM = 1.5  # times the recording's range, over which a module is taught its law
FINEST = 2.0**-40  # resolution of a port whose channel has none
POINTS = 200  # at which a law is taught
MARGIN = 1.25  # of a port's scale over the largest value recorded


@dataclass(frozen=True)
class Law:
    """What a module shall answer. reads: the signal that it answers to, by a name that the augmentation gives it.

    at: (N,) values of that signal. answers: (N,), in the unit of what is missing.
    """

    reads: str
    at: np.ndarray
    answers: np.ndarray

    @property
    def reach(self) -> float:
        return float(np.abs(self.at).max())

    @property
    def size(self) -> float:
        return float(np.abs(self.answers).max())

    def record(self) -> Record:
        """Normalised, as the module's ports have it."""
        return Record({"s": self.at / self.reach}, {"y": self.answers / self.size})

    def module(self) -> Network:
        """A tanh network that has learnt the law."""
        return train(untaught(), [self.record()], epochs=EPOCHS, decay=DECAY).network


class Augmentation(Protocol):
    """The structured network of a plant, without and with a module for an effect that a diagnosis named.

    needs: channels. inputs: of the network. starts: the position that begins at 0.
    effects: name -> (place of its term, what its module reads). modules: names that the module has in the network.
    tied: parameters that training keeps equal. period: s, of a sample of the network.
    """

    needs: ClassVar[tuple[str, ...]]
    inputs: ClassVar[tuple[str, ...]]
    starts: ClassVar[str]
    effects: ClassVar[Mapping[str, tuple[str, str]]]
    modules: ClassVar[tuple[str, ...]]
    tied: ClassVar[tuple[tuple[str, ...], ...]]
    period: float

    def __init__(self, rig: Rig, values: Mapping[str, float]):
        """values: the plant's parameters as diagnosed."""

    def recording(self, recorded: Recording) -> Recording:
        """A recording of the rig as the network samples and reads it."""

    def law(self, recorded: Recording, reads: str, term: Callable[..., np.ndarray]) -> Law:
        """The law over the recording's range and ROOM more. term: signals by name -> the effect's term."""

    def network(self, recorded: Recording, law: Law | None) -> Network:
        """The network, with a module that has learnt the law if there is one."""


def untaught() -> Network:
    """A module before it is taught: from `s` to `y`."""
    return feedforward("missing", ["s"], [HIDDEN], SEED)


def grid() -> np.ndarray:
    """Values from -1 to 1, of which none is 0."""
    return np.linspace(-1, 1, POINTS)


def port(name: str, samples: np.ndarray, unit: str, channel: Channel | None) -> Port:
    """A port whose scale is a power of two times its sensor's resolution, with a quarter of room."""
    step = channel.resolution if channel and channel.resolution else FINEST
    scale = step * 2.0 ** np.ceil(np.log2(MARGIN * np.abs(samples).max() / step))
    return Port(name, unit, float(scale), resolution=channel.resolution if channel else 0.0)
