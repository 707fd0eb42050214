"""The thesis's benchmark systems over 10 seeds: training MSE and free-run RMSE, pruned and not, median and worst.

python benchmarks/systems.py [SEEDS] : writes benchmarks/results/systems.csv, a line for each seed and network, and
prints the table. A seed is the whole procedure, its starts chosen on held-out records
(machines/benchmark_systems/study.py).
"""

import csv
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from statistics import median

from threadpoolctl import threadpool_limits

from greygate.machines.benchmark_systems.study import SYSTEMS, THESIS, figures, identify, prune

RESULTS = Path(__file__).parent / "results" / "systems.csv"
PRUNED = ("b1_30", "b2")
COLUMNS = ("network", "seed", "neurons", "parameters", "mse", "held", "rmse", "starts", "cpu_seconds")


def one(name: str, seed: int) -> list[dict]:
    with threadpool_limits(1, "blas"):
        system = SYSTEMS[name]
        network, found = identify(system, seed)
        rows = [{"network": name, "seed": seed} | found]
        if name in PRUNED:
            smaller, _ = prune(system, seed, network, 1.0)
            rows.append({"network": f"{name} pruned", "seed": seed} | figures(system, smaller, seed))
        return rows


def main(seeds: int) -> None:
    rows = []
    with ProcessPoolExecutor(2) as pool:
        for job in as_completed(pool.submit(one, name, seed) for name in SYSTEMS for seed in range(seeds)):
            rows += job.result()
            print(*rows[-1].values(), file=sys.stderr)
    rows.sort(key=lambda row: (row["network"], row["seed"]))
    RESULTS.parent.mkdir(exist_ok=True)
    with RESULTS.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    for name in dict.fromkeys(row["network"] for row in rows):
        print(f"{name:13}", end="")
        for key in ("neurons", "parameters", "mse", "rmse"):
            values = [row[key] for row in rows if row["network"] == name]
            print(f"  {key} median {median(values):.3g} worst {max(values):.3g}", end="")
        print(f"  thesis {THESIS[name.split()[0]]}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
