"""Our own diagnosis as a tool of the blind benchmark: `python entrant.py explain|predict ...`.

It reads and writes files as every tool does; the names of our table become those of the benchmark's vocabulary.
"""

import json
import sys
from pathlib import Path

from greygate.errors import InputError
from greygate.mismatch.entries import entries, read
from greygate.mismatch.general import GENERAL

NAMES = {  # of our table -> of the benchmark, where they differ
    "friction_between": "dry_friction",
    "direction_friction_between": "direction_friction",
    "cubic_spring_between": "hardening_spring",
}
KEPT = "diagnosis.json"


def _name(effect: str) -> str:
    """The benchmark's name of an effect: a general one goes there without the place that it has here."""
    if effect in read():
        return effect
    general = max((n for n in entries(GENERAL) if f"{effect}_".startswith(f"{n}_")), key=len, default=effect)
    return NAMES.get(general, general)


def answer(diagnosis: dict) -> dict:
    """The benchmark's answer (docs/benchmark.md) that a diagnosis.json gives."""
    claims = [
        {
            "name": _name(effect["id"]),
            "confidence": effect.get("confidence"),
            "parameters": effect.get("parameters", {}),
        }
        for effect in diagnosis["effects"]
        if effect["id"] != "unknown"
    ]
    released = any("outside_tolerance" in p for p in diagnosis["parameters"].values())
    return {
        "schema": "concealed-answer/1",
        "verdict": diagnosis["verdict"],
        "claims": claims,
        "where": [{"equation": w["equation"], "depends_on": w["depends_on"]} for w in diagnosis["where"]],
        "parameters": diagnosis["parameters"],
        "corrects": bool(diagnosis["effects"] or released),
    }


def main(arguments: list[str]) -> int:
    from greygate.mismatch.explain import explain, predict

    what, case, place = arguments[0], Path(arguments[1]), Path(arguments[2])
    if what == "explain":
        found, _ = explain(case, place / KEPT)
        (place / "answer.json").write_text(json.dumps(answer(found), indent=1) + "\n")
    else:
        predict(case, Path(arguments[3]), place / KEPT, place / "predicted.csv")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except InputError as error:
        sys.exit(f"greygate: {error}")
