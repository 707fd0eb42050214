"""Commands on folders that `greygate compile` wrote: emulate, verify, prove, synthesize, report, compare."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import options, words
from greygate.cli.terminal import Json, following, give
from greygate.errors import InputError
from greygate.hardware.families import PLACED

if TYPE_CHECKING:
    from greygate.cli.printed import Comparing, Emulating, Proving, Verifying
    from greygate.emulator.program import Clipped, Terminal

ECP5, ICE40 = words.Target("ecp5"), words.Target("ice40")


def emulate(
    folder: words.Build,
    recording: words.Scenario,
    out: Annotated[Path, typer.Option(metavar="FILE.csv", help="CSV to write the predicted outputs to.")],
    as_json: Json = False,
) -> None:
    """Compute what the hardware answers, bit for bit."""
    from greygate.emulator.emulation import emulate as run
    from greygate.hardware.build import Project
    from greygate.plants.recording import Recording

    project = Project.open(folder)
    inputs, dt = project.inputs(recording)
    answer = run(project.program, inputs)
    units = {p.name: p.unit for p in project.program.outputs}
    Recording(dt, answer.outputs, units).write_csv(out)
    counted = f"saturations {answer.saturations or 'none'}, clipped inputs {len(answer.clipped) or 'none'}"
    lines = [f"{answer.steps} steps, {counted}"]
    lines += [_clipping(p, answer.clipped[p.name]) for p in project.program.inputs if p.name in answer.clipped]
    counts = dict(answer.saturations)
    result: Emulating = {"steps": answer.steps, "saturations": counts, "clipped": dict(answer.clipped), "out": str(out)}
    give("emulate", result, as_json, [*lines, f"written to {out}"])


def _clipping(port: "Terminal", found: "Clipped") -> str:
    """Say how much of an input lies outside its format."""
    holds, given = (f"{least:.6g} to {most:.6g} {port.unit}" for least, most in (found.holds, found.given))
    share = f"{found.count} samples ({found.share:.2%})"
    return f"input {port.name}: {share} clipped to {holds}, which {port.signal.fix} holds; given {given}"


def verify(
    folder: words.Build,
    scenario: Annotated[list[str], typer.Option(metavar="NAME", help="Only this scenario.")] = [],
    seed: Annotated[int | None, words.SEED] = None,
    as_is: Annotated[bool, typer.Option("--as-is", help="Verify changed Verilog too. It is code: read it.")] = False,
    as_json: Json = False,
) -> None:
    """Simulate the Verilog; compare every bit with the emulator.

    The seed is that of back-pressure and reset; it is drawn and printed if not given. Exit code 1 if a bit differs:
    simulation/ARCHITECTURE/dump.vcd is then a waveform of the first step that does. results-ARCHITECTURE.xml in the
    folder is JUnit.
    """
    from greygate.hardware.build import Project
    from greygate.project import verify_project

    project = Project.open(folder)
    with following(f"simulating {project.program.name}"):
        results = verify_project(project, tuple(scenario), seed, as_is)
    verdicts = [v for r in results.values() for v in r.verdicts]
    lines = [
        f"{v.program} {v.architecture:9} {v.scenario:12} {v.steps:6} steps, {v.clocks_per_step:6.1f} clocks a step: "
        + (v.mismatch or "every bit of every output and state equal")
        for v in verdicts
    ]
    passed = all(r.passed for r in results.values())
    waveforms = {name: str(r.waveform) for name, r in results.items() if r.waveform is not None}
    lines += [f"waveform of the first step that differs: {path}" for path in waveforms.values()]
    result: Verifying = {"passed": passed, "verdicts": verdicts, "waveforms": waveforms}
    give("verify", result, as_json, lines, passed)


def prove(
    folder: words.Build,
    only: Annotated[
        list[str], typer.Option(metavar="PROOF", help="primitives, sums, handshake, bound, netlist, drift; no other.")
    ] = [],
    target: Annotated[words.Target, words.TARGET] = ICE40,
    architecture: Annotated[list[words.Architecture], words.ARCHITECTURE] = [],
    steps: Annotated[int, typer.Option(callback=options.COUNT, help="Steps of the long run.")] = 1_000_000,
    seconds: Annotated[float | None, words.SECONDS] = None,
    as_json: Json = False,
) -> None:
    """Prove what the Verilog computes, and bound its errors.

    Every architecture of the build is proved if none is given. The time limit is that of each tool, on the CPU. Exit
    code 1 if a proof fails; one for which nothing could be shown says why, and is no failure.
    """
    from greygate.hardware.build import Project
    from greygate.hardware.proofs.build import prove as run

    project = Project.open(folder)
    with following(f"proving {project.program.name}") as progress:
        proofs = run(project, tuple(only), target.value, tuple(a.value for a in architecture), steps, seconds, progress)
    holds = all(proof.holds is not False for proof in proofs)
    result: Proving = {"holds": holds, "proofs": proofs}
    give("prove", result, as_json, [proof.line() for proof in proofs], holds)


def synthesize(
    folder: words.Build,
    target: Annotated[words.Target, words.TARGET] = ECP5,
    clock_rate: Annotated[
        bool, typer.Option("--clock-rate", help=f"Place and route with nextpnr, too: {', '.join(PLACED)}.")
    ] = False,
    mhz: Annotated[float | None, words.MHZ] = None,
    seconds: Annotated[float | None, words.SECONDS] = None,
    keep: Annotated[bool, typer.Option(help="Keep the figures in the package, for `report --all`.")] = False,
    as_json: Json = False,
) -> None:
    """Count LUTs, DSPs and memories; find the clock rate.

    Yosys counts, nextpnr places and routes: slow. The time limit is that of the tools of each design, on the CPU. Exit
    code 1 if the design does not reach --mhz.
    """
    from greygate.hardware.build import Project
    from greygate.project import synthesize_project

    project = Project.open(folder)
    with following(f"synthesizing {project.program.name} for {target.value}") as progress:
        found = synthesize_project(project, target.value, clock_rate, seconds, keep, mhz, progress)
    lines = [f"{name}: {_counted(figures)}" for name, figures in found.items()]
    met = [figures.get("meets") for name, figures in found.items() if name.endswith(f", {target.value}")]
    give("resources", found, as_json, lines, mhz is None or all(met))


def _counted(figures: dict[str, float | None]) -> str:
    """The figures of a design on a target; a condition as a word."""
    words = {0.0: "no", 1.0: "yes"}
    found = {
        k: words.get(v or 0.0, "no") if k in ("fits", "meets") else "none" if v is None else f"{v:.6g}"
        for k, v in figures.items()
    }
    return ", ".join(f"{name} {value}" for name, value in found.items())


def report(
    folders: words.Builds = [],
    every: Annotated[
        bool, typer.Option("--all", help="Compare the thesis's plants, each from FOLDER/NAME; compile what is missing.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--verify", help="First verify the builds that have not been verified.")
    ] = False,
    html: Annotated[
        Path, typer.Option(metavar="FILE.html", help="HTML page to write; the JSON goes beside it.")
    ] = Path("report.html"),
    as_json: Json = False,
) -> None:
    """Report what fixed point costs, as one HTML page.

    --all takes one FOLDER, or `hardware` if none is given. Exit code 1 if --verify finds a differing bit.
    """
    from greygate.hardware.build import Project
    from greygate.pages.summary import aligned, designs, results
    from greygate.project import verify_project
    from greygate.reporting import plants
    from greygate.reporting import report as measure

    if every and len(folders) > 1:
        raise InputError(f"--all takes one folder that holds a folder for each plant, not {len(folders)}")
    if not every and not folders:
        raise InputError("report: give folders that `greygate compile` wrote, or --all")
    if not html.name or html.suffix == ".json":
        raise InputError(f"--html {html}: name an HTML page, such as report.html; the JSON beside it ends in .json")
    passed = True
    with following("measuring") as progress:
        projects = plants((folders or [Path("hardware")])[0], progress) if every else [Project.open(f) for f in folders]
        for project in projects if check else ():
            if project.hardware is None:
                progress(f"simulating {project.program.name}")
                passed &= all(result.passed for result in verify_project(project).values())
        studies = measure(projects, html, side_by_side=every, progress=progress)
    tables = [results(studies), designs(studies)] if every else []
    lines = [line for table in tables for line in (*aligned(table), "")] or _errors(studies)
    give("report", studies, as_json, [*lines, f"written to {html} and {html.with_suffix('.json')}"], passed)


def compare(
    old: Annotated[Path, typer.Argument(metavar="OLD", help="The build as it was.")],
    new: Annotated[Path, typer.Argument(metavar="NEW", help="The build as it is.")],
    budget: Annotated[Path | None, words.BUDGET] = None,
    html: Annotated[Path | None, typer.Option(metavar="FILE.html", help="HTML page to write.")] = None,
    as_json: Json = False,
) -> None:
    """Compare two builds: error, size, resources, clocks.

    Without a budget no figure may grow. Exit code 1 if one of the new build is worse than the budget allows.
    """
    from greygate.hardware.build import Project
    from greygate.hardware.comparing import compare as differences
    from greygate.hardware.comparing import read_budget
    from greygate.pages.compared import LEFT, page, rows
    from greygate.pages.summary import aligned
    from greygate.pages.templates import write

    allowed = None if budget is None else read_budget(budget)
    found = differences(Project.open(old), Project.open(new), allowed)
    if html is not None:
        write(page(found, str(old), str(new)), html)
    worse = [one for one in found if one.worse]
    result: Comparing = {"worse": len(worse), "differences": [{**vars(one), "growth": one.growth} for one in found]}  # type: ignore[typeddict-item]
    verdict = f"{len(worse)} of {len(found)} figures worse than allowed" if worse else "no figure worse than allowed"
    lines = [*aligned(rows(found), LEFT), verdict, *([f"written to {html}"] if html else [])]
    give("compare", result, as_json, lines, not worse)


def _errors(studies: list[dict]) -> list[str]:
    """RMSE of the float network and of fixed point, one line for each plant, scenario and output."""
    from greygate.pages.units import display

    lines = []
    for study in studies:
        lines.append(study["title"])
        for name, scenario in study["scenarios"].items():
            for label, figures in scenario["outputs"].items():
                factor, unit = display(figures["unit"], figures["rmse"]["fixed"])
                float_, fixed = (factor * figures["rmse"][kind] for kind in ("float", "fixed"))
                unit = unit and f" {unit}"
                lines.append(f"  {name:10} {label:8} RMSE float {float_:8.4g}{unit}, fixed {fixed:8.4g}{unit}")
    return lines
