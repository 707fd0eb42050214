"""The other process for MCAP: numbers in messages of JSON, by topic and field, at their log times."""

import json
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError, brought_by
from greygate.foreign.child import Read, Room

LONGEST = 1000  # characters of a name
PART = 4096  # values that are counted at a time
NANO = 1e-9


class _Series:
    """Values of one name. They belong to the stamps from `begin` on; where some have none, to those at `places`."""

    def __init__(self, begin: int):
        self.values, self.begin = array("d"), begin
        self.places: array[int] | None = None
        self.truths = True

    def add(self, value: float, place: int) -> None:
        if self.places is None and self.begin + len(self.values) != place:
            self.places = array("q", range(self.begin, self.begin + len(self.values)))
        if self.places is not None:
            self.places.append(place)
        self.truths = self.truths and isinstance(value, bool)
        self.values.append(value)

    def of(self, stamps: np.ndarray) -> np.ndarray:
        """Their part of the stamps."""
        if self.places is None:
            return stamps[self.begin : self.begin + len(self.values)]
        return stamps[np.frombuffer(self.places, np.int64)]


def mcap() -> Read:
    """What reads an MCAP file."""
    with brought_by("mcap", "mcap"):
        from mcap.opcode import Opcode
        from mcap.records import Channel, Chunk, Message
        from mcap.stream_reader import StreamReader, get_chunk_data_stream

    def records(path: Path, room: Room) -> Iterator[Any]:
        """Channels and messages in the order of the file, one chunk unpacked at a time."""
        with path.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=room.size).records:
                if not isinstance(record, Chunk):
                    yield record
                    continue
                if record.uncompressed_size > room.bytes:
                    room.take(record.uncompressed_size // 8, "a chunk")
                stream, size = get_chunk_data_stream(record, validate_crc=True)
                while stream.count < size:
                    kind, length = stream.read1(), stream.read8()
                    if kind == Opcode.CHANNEL:
                        yield Channel.read(stream)
                    elif kind == Opcode.MESSAGE:
                        yield Message.read(stream, length)
                    else:
                        stream.read(length)

    def read(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
        topics: dict[int, tuple[str, str]] = {}
        stamps: dict[str, array] = {}
        series: dict[tuple[str, str], _Series] = {}
        other = set()
        for record in records(path, room):
            if isinstance(record, Channel):
                topics[record.id] = record.topic.strip("/"), record.message_encoding
            elif isinstance(record, Message):
                topic, encoding = topics[record.channel_id]
                if encoding != "json":
                    other.add(encoding)
                    continue
                times = stamps.setdefault(topic, array("Q"))
                for name, value in _numbers(json.loads(record.data), topic):
                    one = series.get((topic, name))
                    if one is None:
                        room.take(0, name)
                        one = series[topic, name] = _Series(len(times))
                    elif len(one.values) % PART == 0:
                        room.more(PART, name)
                    one.add(value, len(times))
                times.append(record.log_time)
        if not series and other:
            raise InputError(f"its messages are in {', '.join(sorted(other))[:100]}; those in json are read")
        yield from _columns(series, {topic: np.frombuffer(t, np.uint64) for topic, t in stamps.items()})

    return read


def _columns(
    series: dict[tuple[str, str], _Series], stamps: dict[str, np.ndarray]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Columns of two values or more. Times are whole nanoseconds until they count from the first message."""
    first = min((t.min() for t in stamps.values() if len(t)), default=np.uint64(0))
    since = {topic: (t - first).astype(np.int64) * NANO for topic, t in stamps.items()}
    short = {name.rpartition("/")[2] for _, name in series}
    bare = len(short) == len(series)  # the topic tells nothing
    for (topic, name), one in series.items():
        if len(one.values) < 2:
            continue
        time, values = one.of(since[topic]), np.frombuffer(one.values)
        if (np.diff(time) < 0).any():  # the order of the log
            order = np.argsort(time, kind="stable")
            time, values = time[order], values[order]
        header = name.rpartition("/")[2] if bare else name
        yield name, {"header": header, "unit": "1" if one.truths else "", "values": values, "time": time}


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    if len(name) > LONGEST:
        raise InputError(f"a name of more than {LONGEST} characters, {name[:40]}...; shorten it")
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(inner, f"{name}/{key}")
    elif isinstance(value, int | float):
        yield name, value
