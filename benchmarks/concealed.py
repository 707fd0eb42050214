"""Hundreds of recordings with something concealed in them, diagnosed and scored.

Every case is drawn by `greygate dev conceal`, whose equations, integrator, step and sensors are not the diagnoser's.
The diagnosis runs in its own process on a folder that holds the recordings and `rig.toml` alone. A line a case goes to
`results/concealed.csv` as it ends (an interrupted run goes on from there); `--only-table` prints the table from it and
draws the confusion matrix.
"""

import csv
import json
import shutil
import time
from collections import Counter, defaultdict
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np

from greygate.mismatch.verdict import Verdict

from .made import place, stamp
from .shared import Jobs, scratch, stopwatch

TAKES = "an hour"
PLANTS = ("valve_hydraulic", "pump_hydraulic", "belt_drive", "cable_drum")
CASES = {"one": 38, "clean": 8, "parameter": 4, "foreign": 10, "two": 10}  # of each plant
SEED = 1000
FRESH, FRESH_CASES = 9100, {"one": 12, "clean": 4, "two": 8, "foreign": 4}  # seeds nobody looked at before
FIELDS = (
    "plant", "kind", "seed", "form", "concealed", "parameter", "removable", "strength", "verdict", "named", "apart",
    "first", "all", "false", "equation", "place", "variables", "released", "inside", "off", "removed", "seconds", "cpu",
)  # fmt: skip


def case(plant: str, kind: str, seed: int) -> dict:
    """Draw, diagnose and score one case."""
    from greygate.mismatch import rig as rigs
    from greygate.mismatch.concealed.conceal import conceal, reveal
    from greygate.mismatch.diagnose import diagnose
    from greygate.mismatch.simulation import simulate

    with scratch() as folder:
        sealed, seen = folder / "sealed", folder / "seen"
        conceal(plant, seed, sealed, kind=kind)
        seen.mkdir()
        for name in ("rig.toml", "identify.csv", "holdout.csv"):
            shutil.copy(sealed / name, seen)
        wall, cpu = stopwatch(), stopwatch(time.process_time)
        rig = rigs.load(seen)
        result = diagnose(rig)
        wall, cpu = wall(1), cpu(1)
        result.write(seen / "diagnosis.json")
        claim = json.loads((seen / "diagnosis.json").read_text())
        third = rig.recording(sealed / "third.csv")
        predicted = simulate(rig, third, claim)
        table = np.column_stack([third.time, *predicted.values()])
        header = ",".join(("t", *predicted))
        np.savetxt(seen / "predicted.csv", table, delimiter=",", header=header, comments="", fmt="%.10g")
        score = reveal(sealed, seen / "diagnosis.json", {"corrected": seen / "predicted.csv"})
        answer = json.loads((sealed / "sealed.json").read_text())
    claimed = dict(claim["parameters"])
    for effect in claim["effects"]:
        claimed |= effect["parameters"]
    truth = answer["parameters_true"] | answer["effects_true"]
    off = {
        name: round((value - np.mean(claimed[name]["ci95"])) / (np.ptp(claimed[name]["ci95"]) / 2 + 1e-300), 3)
        for name, value in truth.items()
        if name in claimed and not name.endswith("_phase")
    }
    return {
        "plant": plant, "kind": kind, "seed": seed, "form": answer["form"], "concealed": "+".join(answer["concealed"]),
        "parameter": answer["parameter"] or "", "removable": score["removable"], "strength": _strength(answer),
        "verdict": claim["verdict"], "named": "+".join(e["id"] for e in claim["effects"]),
        "apart": "+".join(n for e in claim["effects"] for n in e["not_told_apart_from"]),
        "first": score["right_first"], "all": score["all_named"], "false": "+".join(score["false_effects"]),
        "equation": score["right_equation"], "place": score["right_place"], "variables": score["depends_on"],
        "released": "+".join(n for n, p in claim["parameters"].items() if p.get("outside_tolerance")),
        "inside": json.dumps(score["inside"]), "off": json.dumps(off), "removed": score["removed"],
        "seconds": wall, "cpu": cpu,
    }  # fmt: skip


def _strength(answer: dict) -> float:
    return round(max(answer["strength"].values(), default=0.0), 3)


def plan(fresh: bool = False) -> list[tuple[str, str, int]]:
    """Every case, the plants and kinds mixed, so that a part of them already says something."""
    cases = []
    for kind, count in (FRESH_CASES if fresh else CASES).items():
        for number in range(count):
            seed = (FRESH if fresh else SEED) + number
            cases += [((number + 0.5) / count, plant, kind, seed) for plant in PLANTS]
    return [(plant, kind, seed) for _, plant, kind, seed in sorted(cases)]


def run(path: Path, jobs: int, fresh: bool = False) -> None:
    done = {(row["plant"], row["kind"], int(row["seed"])) for row in read(path)} if path.exists() else set()
    todo = [job for job in plan(fresh) if job not in done]
    new = not path.exists()
    with path.open("a", newline="") as file, ProcessPoolExecutor(jobs) as pool:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        if new:
            writer.writeheader()
        waiting = {pool.submit(case, *job): job for job in todo}
        for future in as_completed(waiting):
            try:
                writer.writerow(row := future.result())
            except Exception as error:  # one case that breaks is a result too
                plant, kind, seed = waiting[future]
                print(f"{plant} {kind} {seed}: {error!r}", flush=True)
                continue
            file.flush()
            print(*(row[k] for k in ("plant", "kind", "seed", "concealed", "verdict", "named", "seconds")), flush=True)


def read(path: Path) -> list[dict]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def share(rows: list, test) -> str:
    """How many of the rows pass, "12 of 13, 92 %"."""
    good = sum(bool(test(row)) for row in rows)
    return f"{good} of {len(rows)}, {good / len(rows):.0%}" if rows else "none"


def table(rows: list[dict]) -> list[str]:
    """Lines of the table."""
    by = defaultdict(list)
    for row in rows:
        by[row["kind"]].append(row)
    one, two, foreign = by["one"], by["two"], by["foreign"]
    strong = [row for row in one if float(row["removable"] or 0) >= 0.5]
    quiet = by["clean"] + by["parameter"]
    standard = [row for row in rows if row["form"] == "standard" and row["kind"] != "foreign"]
    right = [row for row in standard if row["kind"] in ("clean", "parameter") or row["all"] == "True"]
    inside = [ok for row in right for ok in json.loads(row["inside"]).values()]
    removed = [float(row["removed"]) for row in strong + two if row["removed"] not in ("", "None")]
    seconds, cpu = (np.median([float(row[key]) for row in rows]) for key in ("seconds", "cpu"))
    honest = [row for row in foreign if row["verdict"] in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED)]
    lines = [
        f"cases: {len(rows)} ({', '.join(f'{k} {len(v)}' for k, v in by.items())})",
        f"right effect first, where it removes half or more of the error: {share(strong, _first)}",
        f"right effect first, all single effects: {share(one, _first)}",
        f"right place (a flow and its continuity are one): {share([r for r in one if r['named']], _placed)}",
        f"false claims on clean or miscalibrated rigs: {share(quiet, lambda r: bool(r['named']))}",
        f"parameter outside its tolerance found: {share(by['parameter'], lambda r: r['parameter'] in r['released'])}",
        f"true values inside 95 % intervals (standard forms): {share(inside, bool)}",
        f"median share of the removable error removed on unseen data: {np.median(removed) if removed else np.nan:.3f}",
        f"outside the vocabulary, unexplained: {share(foreign, lambda r: r['verdict'] == Verdict.UNEXPLAINED)}",
        f"  or partly explained: {share(foreign, lambda r: r in honest)}",
        f"  of these with the right equation: {share(honest, _placed)}",
        f"  and a right variable: {share(honest, lambda r: _placed(r) and float(r['variables'] or 1) > 0)}",
        f"  a wrong name claimed: {share(foreign, lambda r: r['verdict'] == Verdict.MISSING_PHYSICS)}",
        f"two effects, both named: {share(two, lambda r: r['all'] == 'True')}",
        f"  none false: {share(two, lambda r: not r['false'])}",
        f"seconds a rig, median: {seconds:.0f} (processor {cpu:.0f})",
        "right effect first, by size of the effect beside the noise:",
    ]
    return lines + [f"  {name}: {share(part, _first)}" for name, part in by_size(one).items()]


SIZES = (3.0, 10.0, 30.0, 100.0)


def by_size(rows: list[dict]) -> dict[str, list[dict]]:
    """Rows by the RMS of what is concealed over the sensor's, in the channel where it shows most."""
    edges = (0.0, *SIZES, np.inf)
    names = [f"below {SIZES[0]:g}", *(f"{a:g} to {b:g}" for a, b in pairwise(SIZES)),
             f"above {SIZES[-1]:g}"]  # fmt: skip
    parts = {n: [r for r in rows if a <= float(r["strength"]) < b]
             for n, a, b in zip(names, edges[:-1], edges[1:], strict=True)}  # fmt: skip
    return {name: part for name, part in parts.items() if part}


def _first(row: dict) -> bool:
    return row["first"] == "True"


def _placed(row: dict) -> bool:
    return row["place"] == "True"


def confusion(rows: list[dict]) -> Counter:
    """(concealed, named first) of single effects and quiet rigs."""
    pairs: Counter = Counter()
    for row in rows:
        if row["kind"] in ("one", "clean", "parameter"):
            named = row["named"].split("+")[0] or row["verdict"]
            pairs[row["concealed"] or row["kind"], named] += 1
    return pairs


def draw(rows: list[dict], path: Path) -> None:
    """The confusion matrix as SVG: what was concealed down, what was named first across; wrong ones in orange."""
    pairs = confusion(rows)
    hidden = sorted({a for a, _ in pairs})
    named = sorted({b for _, b in pairs}, key=lambda b: (b not in hidden, b))
    cell, left, top = 20, 190, 170
    sizes = by_size([row for row in rows if row["kind"] == "one"])
    below = top + cell * len(hidden) + 40
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {left + cell * len(named) + 10} '
        f'{below + cell * len(sizes) + 10}" font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
    ]
    for j, b in enumerate(named):
        x = left + cell * j + cell / 2 + 4
        parts.append(f'<text x="{x}" y="{top - 6}" transform="rotate(-60 {x} {top - 6})" fill="#333333">{b}</text>')
    same = {"clean": Verdict.CONSISTENT, "parameter": Verdict.PARAMETER_ERROR}
    for i, a in enumerate(hidden):
        y = top + cell * i
        parts.append(f'<text x="{left - 6}" y="{y + 14}" text-anchor="end" fill="#333333">{a}</text>')
        for j, b in enumerate(named):
            count = pairs[a, b]
            right = b == same.get(a, a)
            fill = "#f4f4f4" if not count else "#4878b0" if right else "#e08030"
            parts.append(f'<rect x="{left + cell * j}" y="{y}" width="{cell - 1}" height="{cell - 1}" fill="{fill}"/>')
            if count:
                parts.append(
                    f'<text x="{left + cell * j + 9}" y="{y + 14}" text-anchor="middle" fill="#ffffff">{count}</text>'
                )
    parts.append(f'<text x="{left}" y="{below - 10}" fill="#333333">single effects by size over noise</text>')
    wide = cell * len(named) / max(map(len, sizes.values()), default=1)
    for i, (name, part) in enumerate(sizes.items()):
        y, right = below + cell * i, sum(map(_first, part))
        parts.append(f'<text x="{left - 6}" y="{y + 14}" text-anchor="end" fill="#333333">{name}</text>')
        for x, count, fill in ((left, right, "#4878b0"), (left + wide * right, len(part) - right, "#e08030")):
            width = wide * count
            parts.append(f'<rect x="{x:.1f}" y="{y}" width="{width:.1f}" height="{cell - 1}" fill="{fill}"/>')
            if count:
                parts.append(f'<text x="{x + 4:.1f}" y="{y + 14}" fill="#ffffff">{count}</text>')
    path.write_text("\n".join([*parts, "</svg>", ""]))


def main(
    *,
    jobs: Jobs = 2,
    only_table: Annotated[bool, "only print the table and draw the matrix"] = False,
    fresh: Annotated[bool, "112 cases of other seeds, to results/concealed_fresh.csv"] = False,
) -> None:
    path = place("concealed_fresh.csv" if fresh else "concealed.csv")
    if not only_table:
        run(path, jobs, fresh)
    rows = read(path)
    lines = table(rows)
    path.with_suffix(".txt").write_text("\n".join(lines) + "\n")
    if not fresh:
        draw(rows, path.with_suffix(".svg"))
    for ending in (".csv", ".txt", *[".svg"] * (not fresh)):
        stamp(path.with_suffix(ending))
    print("\n".join(lines))
