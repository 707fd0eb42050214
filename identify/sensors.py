"""Gains and offsets that a sensor has in one recording alone: found by a network's free run, and undone."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from greygate.errors import InputError
from greygate.models.accuracy import float_error
from greygate.models.network import Network
from greygate.models.training.objective import STILL, best_gain
from greygate.models.training.record import Record


@dataclass(frozen=True)
class Sensors:
    """By output, the sensor's own gain and its own offset of each element (size,): measured is gain * true + offset."""

    gains: Mapping[str, np.ndarray]
    offsets: Mapping[str, np.ndarray]

    def undone(self, record: Record) -> Record:
        """The record as a sensor without them would have measured it."""
        targets = {}
        for name, measured in record.targets.items():
            columns = np.asarray(measured, float).reshape(len(measured), -1)
            columns = (columns - self.offsets.get(name, 0.0)) / self.gains.get(name, 1.0)
            targets[name] = columns.reshape(np.shape(measured))
        return replace(record, targets=targets, own_offset=frozenset(), own_gain=frozenset())

    def told(self, network: Network) -> tuple[dict[str, float], dict[str, float]]:
        """(gains, offsets) by the names of the outputs' elements."""
        of = {p.name: p.labels for p in network.outputs}
        gains, offsets = (
            {label: float(v) for name, values in found.items() for label, v in zip(of[name], values, strict=True)}
            for found in (self.gains, self.offsets)
        )
        return gains, offsets


def own_sensors(network: Network, record: Record) -> Sensors:
    """Gains and offsets of a record's own that fit the network's free run best; none where it diverges.

    A gain next to 0, of a sensor that did not move, is none: nothing can be divided by it.
    """
    try:
        errors = float_error(network, replace(record, own_offset=frozenset(), own_gain=frozenset()))
    except InputError:
        return Sensors({}, {})
    gains, offsets = {}, {}
    for name in sorted(record.own_offset | record.own_gain):
        measured = np.asarray(record.targets[name], float).reshape(len(record), -1)[record.skip :]
        shown = errors[name].reshape(len(record), -1)[record.skip :] + measured
        found = np.ones(measured.shape[1])
        if name in record.own_gain:
            pairs, about = zip(shown.T, measured.T, strict=True), name in record.own_offset
            found = np.array([best_gain(y, m, about)[0] for y, m in pairs])
            gains[name] = found = np.where(np.abs(found) > STILL, found, 1.0)
        if name in record.own_offset:
            offsets[name] = measured.mean(axis=0) - found * shown.mean(axis=0)
    return Sensors(gains, offsets)
