"""The waveform of a step whose bits differ."""

import shutil
from dataclasses import replace
from pathlib import Path

from greygate.files import scratch, writing
from greygate.hardware.verify import DUMP, Case, Verification, verify_many


def with_waveform(case: Case, found: Verification, folder: Path) -> Verification:
    """Simulate a case again, by the same seed, up to the first step that differs, and keep `folder`/dump.vcd of it.

    The waveform begins a step earlier, and holds the whole design. Its scope `compared_0` has the number of the step,
    and for every output and state what the design has (`hardware`) and what it should have (`emulator`). If nothing
    differs, nothing is simulated. Raises InputError as `verify_many`.
    """
    wrong = next((v for v in found.verdicts if v.mismatch is not None), None)
    if wrong is None:
        return found
    names = list(case.scenarios)
    same = {name: case.scenarios[name] for name in names[: names.index(wrong.scenario) + 1]}
    since = wrong.scenario, max((wrong.step or 0) - 1, 0)
    with scratch() as temporary:
        verify_many([replace(case, scenarios=same)], temporary, found.seed, since=since)
        with writing(folder):
            shutil.move(Path(temporary) / DUMP, folder / DUMP)
    return replace(found, waveform=folder / DUMP)
