"""The head of a study: its program, its headline, and a table of errors with a row for each scenario and output."""

from greygate.pages.units import differing, figure, number


def context(study: dict) -> dict:
    """The study itself beside its headline."""
    return {"s": study, "facts": facts(study)}


def facts(found: dict) -> list[tuple[str, str, bool | None]]:
    """The headline of one study: (value, its meaning, whether it is good, or None)."""
    ratios = [o["ratio"] for s in found["scenarios"].values() for o in s["outputs"].values() if o["ratio"]]
    lines: list[tuple[str, str, bool | None]] = []
    if ratios:
        lines.append((f"× {max(ratios):.3f}", "largest RMSE of fixed point over float", None))
    for name, h in found["hardware"].items():
        steps, bits = ([v[k] for v in h["scenarios"].values()] for k in ("steps", "differing_bits"))
        clocks = f", {figure(h['clocks_per_step'])} clocks each" if h.get("clocks_per_step") else ""
        text = f"{name} Verilog from emulator: {sum(steps):,} steps{clocks}"
        lines.append((differing(None if None in bits else sum(bits)), text, all(b == 0 for b in bits)))
    if found["widths"]["word"]:
        lines.append((f"{found['widths']['word']} bit", "word of signals and weights", None))
    size = found["size"]
    kib = (size["state_bits"] + size["table_bits"]) / 8192
    lines.append((f"{size['multiplications']:,}", "multiplications a step", None))
    lines.append((f"{number(kib)} KiB", f"of tables and states ({size['state_bits']:,} bits of state)", None))
    return lines
