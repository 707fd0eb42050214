"""Every table answers every code as the program says: all codes are tried, which is a proof and no sample."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from greygate.emulator.interpreter import lookup
from greygate.emulator.program import Program
from greygate.hardware.proofs.elaborated import Block
from greygate.hardware.proofs.proof import Proof, timed
from greygate.hardware.replay import simulate
from greygate.progress import Progress, silent

WIDEST = 22  # bits of an argument of which all codes are tried
LATEST = 8  # clocks after which an answer is still found
HOW = "simulation of every code of the argument"


def tables(
    files: Sequence[Path], program: Program, modules: Mapping[str, dict], progress: Progress = silent
) -> list[Proof]:
    """A proof for each table module of the design, all in one simulation. modules: of `elaborate`.

    A module has the ports clk, en, x and y, and SIZE neurons; each sees every code, and no two the same one at once.
    Its answer comes a fixed number of clocks later, which the simulation finds.
    """
    found = list(_instances(program, modules))
    known = [(t, block) for t, block in found if t.arg.width <= WIDEST]
    proofs = [
        Proof(
            f"table {t.name} equals the program",
            HOW,
            None,
            0.0,
            f"an argument of {t.arg.width} bits has too many codes",
        )
        for t, _ in found
        if t.arg.width > WIDEST
    ]
    if not known:
        return proofs
    with timed() as seconds:
        data = {f"wanted_{k}.hex": _answers(t) for k, (t, _) in enumerate(known)}
        results = simulate(files, _bench(known), data, progress=progress)
    for (t, block), result in zip(known, results, strict=True):
        wrong = min(result["wrong"])
        clocks = result["wrong"].index(wrong) + 1
        size = block.ports["x"] // t.arg.width
        figures = {"codes": 1 << t.arg.width, "neurons": size, "wrong": wrong, "clocks": clocks}
        code = result["first"][clocks - 1]
        why = (
            None if wrong == 0 else f"code {code - (1 << t.arg.width) * (code >> (t.arg.width - 1))} has another answer"
        )
        share = seconds[0] / len(known)
        proofs.append(Proof(f"table {t.name} equals the program", HOW, wrong == 0, share, why, figures))
    return proofs


def _instances(program: Program, modules: Mapping[str, dict]) -> Iterator[tuple]:
    """(table, its module with the parameters of the design) for every table module; once for each set of parameters."""
    named = {f"{program.name}_table_{t.name}".replace(".", "__"): t for t in program.tables}
    for name, module in modules.items():
        own = module["attributes"].get("hdlname", name).strip()
        if own in named:
            ports = {p: len(port["bits"]) for p, port in module["ports"].items()}
            yield named[own], Block(own, module.get("parameter_default_values", {}), ports)


def _answers(table) -> str:
    """The answer to each code, the codes in the order of their bits, as lines of hexadecimal."""
    width = table.arg.width
    codes = np.arange(1 << width, dtype=np.int64)
    codes = np.where(codes >> (width - 1), codes - (1 << width), codes)
    mask = (1 << table.out.width) - 1
    return "\n".join(map("{:x}".format, (lookup(table, codes) & mask).tolist())) + "\n"


def _bench(known: Sequence[tuple]) -> str:
    """A bench that counts, for each table and each delay of 1 to LATEST clocks, the answers that are not as wanted."""
    longest = max(1 << t.arg.width for t, _ in known) + LATEST
    parts = "".join(_part(k, t, block) for k, (t, block) in enumerate(known))
    written = ""
    for k in range(len(known)):
        comma = "," if k + 1 < len(known) else ""
        for what, start in (("wrong", '{\\"wrong\\": ['), ("first", '\\"first\\": [')):
            numbers = ", ".join(["%0d"] * LATEST)
            values = ", ".join(f"{what}_{k}[{d}]" for d in range(LATEST))
            end = "], " if what == "wrong" else f"]}}{comma}"
            written += f'            $fwrite(file, "{start}{numbers}{end}", {values});\n'
    return f"""\
module bench (input clk);
    reg [31:0] count = 0;
    integer file;
{parts}    always @(posedge clk) begin
        count <= count + 1;
        if (count == {longest}) begin
            file = $fopen("result.json", "w");
            $fwrite(file, "[");
{written}            $fwrite(file, "]");
            $fclose(file);
            $finish;
        end
    end
endmodule
"""


def _part(k: int, table, block: Block) -> str:
    """The table of number k in the bench. Neuron n sees the code plus n."""
    a, w = table.arg.width, table.out.width
    size = block.ports["x"] // a
    x = ", ".join(f"count[{a - 1}:0] + {a}'d{n % (1 << a)}" for n in reversed(range(size)))
    given = ", ".join(f".{name}({len(bits)}'sb{bits})" for name, bits in block.parameters.items())
    compared = "".join(
        f"                    if (y_{k}[{n * w}+:{w}] != wanted_{k}[at_{k} + {a}'d{n % (1 << a)}]) bad_{k} = 1;\n"
        for n in range(size)
    )
    return f"""\
    wire [{size * w - 1}:0] y_{k};
    reg [{w - 1}:0] wanted_{k}[0:{(1 << a) - 1}];
    integer wrong_{k}[0:{LATEST - 1}];
    integer first_{k}[0:{LATEST - 1}];
    integer d_{k};
    reg [{a - 1}:0] at_{k};
    reg bad_{k};
    initial begin
        $readmemh("wanted_{k}.hex", wanted_{k});
        for (d_{k} = 0; d_{k} < {LATEST}; d_{k} = d_{k} + 1) begin
            wrong_{k}[d_{k}] = 0;
            first_{k}[d_{k}] = 0;
        end
    end
    {block.name} #({given}) table_{k} (.clk(clk), .en(1'b1), .x({{{x}}}), .y(y_{k}));
    always @(posedge clk)
        for (d_{k} = 0; d_{k} < {LATEST}; d_{k} = d_{k} + 1)
            if (count >= d_{k} + 1 && count - d_{k} - 1 < {1 << a}) begin
                at_{k} = count[{a - 1}:0] - d_{k}[{a - 1}:0] - {a}'d1;
                bad_{k} = 0;
{compared}                if (bad_{k}) begin
                    if (wrong_{k}[d_{k}] == 0) first_{k}[d_{k}] = {{{32 - a}'d0, at_{k}}};
                    wrong_{k}[d_{k}] = wrong_{k}[d_{k}] + 1;
                end
            end
"""
