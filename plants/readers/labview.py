"""The other process for LabVIEW's TDMS: channels with their unit, and the times of their waveforms."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError, brought_by, shown
from greygate.foreign.child import Read, Room

START, OFFSET, STEP = "wf_start_time", "wf_start_offset", "wf_increment"
SCALES = {  # that nptdms computes; it passes over any other and gives what the converter counted
    "AdvancedAPI", "Add", "Linear", "Polynomial", "RTD", "Strain", "Subtract", "Table", "Thermistor", "Thermocouple",
}  # fmt: skip
_SCALE = re.compile(r"NI_Scale\[\d+\]_Scale_Type")


def tdms() -> Read:
    """What reads a TDMS file. Times count from the start of the channel that starts first."""
    with brought_by("tdms", "nptdms"):
        import nptdms

    def read(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
        with path.open("rb") as opened, nptdms.TdmsFile.open(opened, raw_timestamps=True) as file:
            channels = [c for group in file.groups() for c in group.channels() if len(c) > 1 and _read(c.dtype)]
            waves = [c.properties for c in channels if c.properties.get(STEP)]
            starts = [_moment(told[START]) for told in waves if START in told]
            for channel in channels:
                for told in (channel.properties, file[channel.group_name].properties, file.properties):
                    _check_scales(channel.name, told)
                room.take(len(channel), channel.name)
                yield channel.path, _column(channel, min(starts, default=0))

    return read


def _read(kind: Any) -> bool:
    return kind.kind in "fiubcM"


def _check_scales(name: str, told: Mapping[str, Any]) -> None:
    """Raise InputError for a scale among the properties that would be left out."""
    if told.get("NI_Scaling_Status", "unscaled") == "scaled":
        return
    for key, kind in told.items():
        if _SCALE.fullmatch(key) and kind not in SCALES:
            raise InputError(f"{shown(name)}: has the scale {shown(str(kind))}, which is not known; save it scaled")


def _column(channel: Any, first: int) -> dict[str, Any]:
    """One channel; its time, if it is a waveform, from `first` on."""
    told, values = channel.properties, channel[:]
    unit = told.get("unit_string")
    unit = unit if isinstance(unit, str) else ""
    if values.dtype.names:
        seconds = values["seconds"] - values["seconds"][0]
        values, unit = seconds + (values["second_fractions"] - float(values["second_fractions"][0])) * 2.0**-64, "s"
    found = {"header": channel.name, "unit": unit or ("1" if values.dtype.kind == "b" else ""), "values": values}
    if step := told.get(STEP):
        axis = told.get("wf_xunit_string") or "s"
        if axis not in ("s", "sec", "seconds"):
            raise InputError(f"{shown(channel.name)}: is over {shown(axis)}, not over time; leave it out")
        if first and START not in told:
            raise InputError(f"{shown(channel.name)}: has no start time, which other channels have; write it for all")
        begin = (_moment(told[START]) - first) * 2.0**-64 if START in told else 0.0
        found["time"] = begin + float(told.get(OFFSET, 0.0)) + float(step) * np.arange(len(values))
    return found


def _moment(stamp: Any) -> int:
    """A time stamp in 2^-64 s."""
    if not hasattr(stamp, "second_fractions"):
        raise InputError(f"a start time is {shown(str(stamp))}, which is no time stamp")
    return (int(stamp.seconds) << 64) + int(stamp.second_fractions)
