"""Every rig of a folder diagnosed by one command with one setting.

FOLDER holds one folder a rig (default: $GREYGATE_RIGS, else ../shared/rigs). Each diagnosis goes to
`results/rigs/NAME.json`; a table is printed and kept in `results/rigs/table.md`. Where a rig has an `answer.json`, it
is read after the diagnosis is written, for the last column alone.
"""

import json
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from .made import place, stamp
from .shared import Jobs

TAKES = "not timed"
RIGS = Path(os.environ.get("GREYGATE_RIGS") or "../shared/rigs")


def explain(folder: Path) -> dict:
    """Diagnose one rig and write its diagnosis.json."""
    from greygate.mismatch import rig as rigs
    from greygate.mismatch.diagnose import diagnose

    result = diagnose(rigs.load(folder))
    result.write(place("rigs") / f"{folder.name}.json")
    return result.as_dict()


def line(folder: Path, found: dict) -> str:
    """A row of the table."""
    effects = [f"{e['id']} ({sizes(e['parameters'])})" for e in found["effects"] if e["id"] != "unknown"]
    outside = [sizes({k: p}) for k, p in found["parameters"].items() if p.get("outside_tolerance")]
    what = "; ".join(effects + outside) or ", ".join(w["equation"] for w in found["where"]) or "-"
    fit = "; ".join(
        " / ".join(f"{channel[k]:.3g}" for k in ("simulation", "calibrated", "corrected"))
        for channel in found["fit"].get("holdout", {}).values()
    )
    return f"| {folder.name} | {found['plant']} | {found['verdict']} | {what} | {fit} | {judged(folder, found)} |"


def sizes(parameters: dict) -> str:
    """Names and values."""
    return ", ".join(f"{name} {p['value']:.4g}" for name, p in parameters.items())


def judged(folder: Path, found: dict) -> str:
    """How a labelled rig's diagnosis compares with its answer; "blind" where there is none."""
    path = folder / "answer.json"
    if not path.exists():
        return "blind"
    answer = json.loads(path.read_text())
    claimed = dict(found["parameters"])
    for effect in found["effects"]:
        claimed |= effect["parameters"]
    truth = answer["parameters_true"] | answer["effects_true"]
    inside = [p["ci95"][0] <= truth[k] <= p["ci95"][1] for k, p in claimed.items() if k in truth]
    right = answer["verdict"] == found["verdict"] and answer["effects"] == [e["id"] for e in found["effects"]]
    return f"{'right' if right else 'wrong'}; {sum(inside)} of {len(inside)} true values inside"


def main(folder: Path = RIGS, *, jobs: Jobs = 2) -> None:
    place("rigs").mkdir(exist_ok=True)
    folders = sorted(path.parent for path in folder.glob("*/rig.toml"))
    rows = [
        "| rig | plant | verdict | what | holdout: data sheet / calibrated / corrected, a channel | answer |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    with ProcessPoolExecutor(jobs) as pool:
        for folder, found in zip(folders, pool.map(explain, folders), strict=True):
            rows.append(line(folder, found))
            print(rows[-1], flush=True)
    (place("rigs") / "table.md").write_text("\n".join(rows) + "\n")
    stamp(place("rigs"))
