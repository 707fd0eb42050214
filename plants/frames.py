"""Recordings and results as tables of pandas."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greygate.errors import InputError, brought_by, shown
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import Recording
from greygate.reading import read_json

if TYPE_CHECKING:
    import pandas

FITTED = ("of", "name", "value", "low", "high", "unit", "confidence")
JUDGED = ("plant", "scenario", "output", "unit", "spread", "float", "fixed", "ratio", "cost")


def to_pandas(source: Any) -> "pandas.DataFrame":
    """A DataFrame of a recording, or of what identify, report or diagnose found, as content or as its file.

    A recording: a column `name_unit` for each channel, as in its CSV, and the index `t_s`. identify: a row for each
    model. report: a row for each plant, scenario and output, with the RMS error of float and fixed point and what
    quantization adds (`cost`). A diagnosis: a row for each parameter of an effect, and for each of the plant, with its
    95 % interval. A figure that is null there is NaN.
    Raises InputError if pandas is not installed, or for another source.

    >>> to_pandas(recording).columns.tolist(), len(to_pandas("lag.csv"))
    (['u_V', 'y_m'], 500)
    >>> to_pandas("report.json")[["scenario", "output"]].values.tolist()
    [['train', 'y']]
    """
    with brought_by("pandas", "pandas"):
        import pandas
    found = _read(source)
    if isinstance(found, Recording):
        channels = dict(zip(found.header, found.channels.values(), strict=True))
        return pandas.DataFrame(channels, index=pandas.Index(found.time, name="t_s"))
    if isinstance(found, list) and all(isinstance(one, Mapping) and "scenarios" in one for one in found):
        return pandas.DataFrame(_judged(found), columns=list(JUDGED))
    if isinstance(found, Mapping) and "models" in found:
        return pandas.DataFrame(found["models"])
    if isinstance(found, Mapping) and "verdict" in found:
        return pandas.DataFrame(_fitted(found), columns=list(FITTED))
    raise InputError(
        f"{shown(str(source))[:100]}: is no recording, and no result of identify, report or diagnose; give one of them"
    )


def _read(source: Any) -> Any:
    """The recording or the result in a file; what a diagnosis found as plain data; anything else as it is."""
    if isinstance(source, str | Path):
        if Path(source).suffix == ".json":
            return read_json(source, "give a result that greygate wrote")
        return read_recording(source)
    return source.as_dict() if hasattr(source, "as_dict") else source


def _judged(studies: list[dict]) -> Iterator[tuple]:
    for study in studies:
        for scenario, run in study["scenarios"].items():
            for output, f in run["outputs"].items():
                errors = f["rmse"]["float"], f["rmse"]["fixed"], f["ratio"], f["quantization"]["rms"]
                yield study["name"], scenario, output, f["unit"], f["spread"], *errors


def _fitted(found: Mapping) -> Iterator[tuple]:
    groups = [(effect["id"], effect["parameters"], effect["confidence"]) for effect in found["effects"]]
    for of, parameters, confidence in (*groups, (found["plant"], found["parameters"], None)):
        for name, p in parameters.items():
            yield of, name, p["value"], *p["ci95"], p["unit"], confidence
