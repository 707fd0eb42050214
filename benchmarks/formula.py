"""A formula for what has no name: the effect is hidden, and no effect of any table may be claimed.

Each case has one effect of a machine's concealed rigs that is a function of its signals. `diagnose` has an empty table.
Asked are: are the variables right, is the kind of function right, how much of the error that can be removed from the
held-out recording does the formula remove, and is any held-out channel worse than calibrated?
"""

import json
from pathlib import Path
from typing import Annotated

import numpy as np

from greygate.mismatch import rig as rigs
from greygate.mismatch.concealed.conceal import EVERY_RIG, conceal
from greygate.mismatch.diagnose import diagnose

from .made import keep, stored
from .shared import scratch, stopwatch

TAKES = "half an hour"
SEEDS = (37, 38)  # others than those it was built with
ODD, EVEN, BENT, SIGN, ROUND, FLAT = "odd", "even", "threshold", "saturating", "periodic", "constant"
CASES: dict[str, dict[str, tuple[str, ...]]] = {  # plant -> effect -> kinds of function that are right
    "motor": {"dry_friction": (SIGN,), "square_damping": (ODD,), "constant_load": (FLAT,), "input_dead_zone": (SIGN,)},
    "pendulum": {
        "dry_friction": (SIGN,),
        "square_damping": (ODD,),
        "constant_load": (FLAT,),
        "input_dead_zone": (SIGN,),
    },
    "electrical": {"leak": ("linear",), "input_offset": (FLAT,), "diode": (BENT,)},
    "thermal": {"leak": ("linear", BENT), "radiation": (BENT, EVEN, ODD)},  # BENT: all that was seen is above the knee
    "tank": {"leak": ("linear", "root"), "weir": (BENT,), "clogging": ("linear", "product")},
    "quarter_car": {"dry_friction": (SIGN,), "hardening_spring": (ODD,), "bump_stop": (BENT,)},
}
SAME = {  # plant -> variables of a generator's answer -> what the plant's file calls them
    "pendulum": {"v": "omega"},
    "quarter_car": {"v z_body z_wheel": "v_body v_wheel"},
}


def case(plant: str, effect: str, seed: int, folder: Path) -> dict:
    """What a diagnosis without any table says of one hidden effect."""
    hidden = EVERY_RIG[plant]
    at = conceal(plant, seed, folder / f"{plant}_{effect}_{seed}", effect=effect,
                 kind="one" if effect in hidden.effects else "foreign")  # fmt: skip
    answer, watch = json.loads((at / "sealed.json").read_text()), stopwatch()
    result = diagnose(rigs.load(at), effects={}).as_dict()
    seconds = watch()
    entry = next((e for e in result["effects"] if e["id"] == "unknown"), None)
    where = result["where"][0] if result["where"] else {"equation": "", "depends_on": []}
    variables = " ".join(sorted(answer["depends_on"]))
    truth = set(SAME.get(plant, {}).get(variables, variables).split())
    terms = entry["parameters"].items() if entry else ()
    kinds = {name.removeprefix(f"unknown_{p['place']}_").split("_")[0] for name, p in terms}
    held = result["fit"]["holdout"]
    ratio = {c: rms["corrected"] / rms["calibrated"] for c, rms in held.items()}
    return {
        "plant": plant, "effect": effect, "seed": seed, "verdict": str(result["verdict"]), "truth": sorted(truth),
        "says": where["depends_on"], "place": where["equation"], "kinds": sorted(kinds),
        "terms": [p["term"] for _, p in terms],
        "variables": bool(entry) and set(where["depends_on"]) == truth,
        "kind": bool(kinds & set(CASES[plant][effect])),
        "removed": 1.0 - float(np.mean([r**2 for r in ratio.values()])), "worse": max(ratio.values()) > 1.0,
        "seconds": round(seconds, 1),
    }  # fmt: skip


def main(*plants: Annotated[str, CASES]) -> None:
    for plant in plants or CASES:
        with scratch("formula-") as folder:
            found = [case(plant, effect, seed, folder) for effect in CASES[plant] for seed in SEEDS]
        for one in found:
            print(json.dumps(one), flush=True)
        keep("formula", plant, {"cases": found})
    store_summary([case for plant in CASES for case in stored("formula").get(plant, {}).get("cases", ())])


def store_summary(cases: list[dict]) -> None:
    """Keep what all cases say together."""
    counts = {name: sum(case[name] for case in cases) for name in ("variables", "kind", "worse")}
    middle = {name: round(float(np.median([case[name] for case in cases])), 3) for name in ("removed", "seconds")}
    keep("formula", "summary", {"cases": len(cases), **counts, **middle}, *CASES)
