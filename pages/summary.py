"""Compares several studies in two tables: the errors of each network, and the resources of each design.

Both are lists of rows, {column: cell}, for the terminal (`aligned`) and for the page of `greygate.pages.report`.
"""

from collections.abc import Collection, Iterator, Sequence

from greygate.pages.units import NONE, display, figure, heading, shown

WIDTHS = (12, 16, 18)
COUNTED = ("luts", "flip_flops", "dsps", "block_rams", "lut_rams", "clock_mhz")
LEFT = ("plant", "scenario", "output", "unit", "design", "target")  # columns of words


def results(studies: Sequence[dict]) -> list[dict[str, str]]:
    """A row for each scenario and output: published RMSE, float, fixed, their ratio for some word widths, hardware.

    A figure from a source called "thesis, on what" is followed by "(on what)".
    """
    widths = dict.fromkeys(width for s in studies for width in s["widths"]["width"] if width != s["widths"]["word"])
    return [
        _result(s, name, label, output, tuple(widths))
        for s in studies
        for name, scenario in s["scenarios"].items()
        for label, output in scenario["outputs"].items()
    ]


def _result(s: dict, name: str, label: str, o: dict, columns: tuple[int, ...]) -> dict[str, str]:
    rmse, unit, widths = o["rmse"], o["unit"], s["widths"]
    published = (
        shown(value, unit, rmse["fixed"]) + (f" ({of})" if (of := source.partition(", ")[2]) else "")
        for source, value in o["references"].items()
    )
    ratios = dict(zip(widths["width"], widths["ratio"][name][label], strict=True))
    return {
        "plant": s["name"],
        "scenario": name,
        "output": label,
        "published": "; ".join(published) or NONE,
        "float": shown(rmse["float"], unit, rmse["fixed"]),
        "fixed": shown(rmse["fixed"], unit, rmse["fixed"]),
        "unit": display(unit, rmse["fixed"])[1] or "1",
        "word": word(s),
        "fixed / float": _times(o["ratio"]),
        **{f"{width} bits": _times(ratios.get(width)) for width in columns},
        "differing bits": _differing(o["hardware"]),
    }


def designs(studies: Sequence[dict]) -> list[dict[str, str]]:
    """A row for each plant, architecture and synthesis target: clocks per step, and every resource that one has."""
    counted = [n for n in COUNTED if any(counts.get(n) is not None for s in studies for *_, counts in _synthesized(s))]
    return [
        {
            "plant": s["name"],
            "design": architecture,
            "word": word(s),
            "clocks a step": figure(s["hardware"].get(architecture, {}).get("clocks_per_step")),
            "target": target,
            **{heading(name): figure(counts.get(name)) for name in counted},
        }
        for s in studies
        for architecture, target, counts in _synthesized(s)
    ]


def _synthesized(s: dict) -> Iterator[tuple[str, str, dict]]:
    """(architecture, target, counts) of every design that was verified or synthesized."""
    found = [(*design.partition(", ")[::2], counts) for design, counts in s["resources"].items()]
    for architecture in dict.fromkeys((*s["hardware"], *(a for a, *_ in found))) or (NONE,):
        own = [f for f in found if f[0] == architecture]
        for _, target, counts in own or [(architecture, "not synthesized", {})]:
            stopped = counts.get("stopped_after_s")
            yield architecture, f"{target}, stopped after {stopped:g} s" if stopped else target, counts


def word(s: dict) -> str:
    """Bits of signals and further bits of weights and neurons, if the program's formats follow from a width tried."""
    bits, finer = s["widths"]["word"], s["widths"]["finer"]
    return f"{bits} + {finer}" if bits and finer else str(bits or NONE)


def _times(ratio: float | None) -> str:
    return NONE if ratio is None else f"{ratio:.3f}"


def _differing(hardware: dict) -> str:
    """The verification result in a word for each architecture, or one for all: "0", "differ", or not known."""
    said = {a: "not verified" if h is None else "0" if h["equals_fixed"] else "differ" for a, h in hardware.items()}
    if len(set(said.values())) < 2:
        return next(iter(said.values()), "not verified")
    return ", ".join(f"{a} {verdict}" for a, verdict in said.items())


def aligned(rows: Sequence[dict[str, str]], left: Collection[str] = LEFT) -> list[str]:
    """Lines for a terminal. left: columns of text."""
    widths = {n: max(len(n), *(len(r[n]) for r in rows)) for n in rows[0]}
    return [
        "  ".join(f"{cells[n]:{'<' if n in left else '>'}{w}}" for n, w in widths.items()).rstrip()
        for cells in ({n: n for n in widths}, *rows)
    ]
