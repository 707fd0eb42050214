"""RMS of each machine's network in float and in fixed point, by word: `python benchmarks/words.py [MACHINE ...]`.

results/words.json: machine -> word -> scenario -> RMS of the outputs in the catalogue's units; `finer 0` is 16 bits
without the bits that weights and neurons have beyond the word; `pruned` is compiled at 16 bits from what pruning left.
`make pages` writes the hardware tables of the machines' pages and of the README from it.
"""

import sys
from collections.abc import Iterable

from made import keep
from threadpoolctl import threadpool_limits

from greygate.compiler.pipeline import compile_network
from greygate.machines.catalog import REPORTED, entry
from greygate.models.accuracy import free_run_rms
from greygate.models.network import Network
from greygate.project import fixed_and_float
from greygate.source import Source

WIDTHS = (12, 16, 18)


def by_word(name: str) -> dict:
    """RMS by word and scenario, and the largest ratio of 16 bits to float."""
    source = Source(name)
    kept = source.network()
    asked = {str(width): (kept, source.formats(width)) for width in WIDTHS}
    if entry(name).finer:
        asked["16, finer 0"] = kept, source.formats(16, 0)
    if prune := entry(name).prune:
        asked["pruned"] = prune(kept.flatten(), 1.0)[0], source.formats(16)
    found: dict = {"float": rms(kept, source)}
    for word, (network, formats) in asked.items():
        compiled = compile_network(network, source.records(), formats, ranged_on=source.training)
        both = {s: fixed_and_float(compiled, record) for s, record in source.records().items()}
        found[word] = {s: [e["fixed"] for e in errors.values()] for s, errors in both.items()}
        if word == "pruned":
            found["pruned, float"] = {s: [e["float"] for e in errors.values()] for s, errors in both.items()}
    ratios = [f / g for s in found["16"] for f, g in zip(found["16"][s], found["float"][s], strict=True)]
    return found | {"largest ratio": max(ratios)}


def rms(network: Network, source: Source) -> dict[str, list[float]]:
    return {name: list(free_run_rms(network, record).values()) for name, record in source.records().items()}


def parts(asked: Iterable[str]) -> None:
    with threadpool_limits(1, "blas"):
        for name in asked:
            keep("words", name, by_word(name))
            print(name, file=sys.stderr, flush=True)


if __name__ == "__main__":
    parts(sys.argv[1:] or REPORTED)
