"""What a name, a unit or a note holds stays text where it leaves: in Verilog, in XML, on pages, whatever its origin."""

import json
import re
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from networks import random_network
from programs import cylinder_program, random_codes, random_program
from test_names import INJECTED, one_line
from test_validation import linear, record

from greygate import pages
from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.study import study
from greygate.compiler.targets import Design
from greygate.compiler.targets.folded import folded
from greygate.compiler.targets.parallel import parallel
from greygate.compiler.verilog import remark
from greygate.emulator.fields import to_json
from greygate.emulator.interpreter import interpret
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.hardware.verify import Case, Scenario, simulator_environment, verify_many
from greygate.models.training.record import Record
from greygate.models.validation import coverage, validate
from greygate.pages import figures
from greygate.pages.diagnosis.sections import ladder as draw_ladder
from greygate.pages.figures import Curve
from greygate.pages.report import page
from greygate.pages.summary import results
from greygate.pages.validation import page as validation_page
from greygate.pages.validation.judged import Judged
from greygate.rtl import block

HOSTILE = [
    INJECTED, "*/ initial $finish; /*", "x\\", "x\\\n initial $finish;", "`include \"/etc/passwd\"",
    "verilator lint_off",
    "verilator", "synopsys translate_off", "pragma translate_off", "</script><script>alert(1)</script>", "<!--",
    "<img src=x onerror=alert(1)>", "\" onload=\"alert(1)", "' onload='x", "&lt;b&gt;", "\u2028x", "\u202e",
    "\r initial;",
    "{{ 7 * 7 }}", "]]>", "$(touch canary)", "é µ °",
]  # fmt: skip


LEXED = [t for t in HOSTILE if re.search(r"initial|\\\\|`|_off|verilator|é", t)]  # what a reader of Verilog might obey


def with_texts(program: Program, text: str) -> Program:
    """The program with another unit, name of each port, note and function of each table; nothing is checked."""
    return replace(
        program,
        inputs=tuple(replace(p, name=f"{text}{i}", unit=text) for i, p in enumerate(program.inputs)),
        outputs=tuple(replace(p, name=f"{text}{i}", unit=text) for i, p in enumerate(program.outputs)),
        tables=tuple(replace(t, function=text) for t in program.tables),
        notes=dict.fromkeys(program.signals, text),
    )


def statements(texts: dict[str, str]) -> dict[str, str]:
    return {name: re.sub(r"//[^\n]*", "", text) for name, text in texts.items()}


def emitted(program: Program, architecture: str) -> dict[str, str]:
    return parallel(program) if architecture == "parallel" else folded(program, Design(multipliers=2))


@pytest.mark.parametrize("architecture", ["parallel", "folded"])
def test_no_text_of_a_program_becomes_a_statement_of_its_verilog(architecture):
    program = cylinder_program()
    plain = statements(emitted(with_texts(program, "plain"), architecture))
    for text in HOSTILE:
        texts = emitted(with_texts(program, text), architecture)
        assert statements(texts) == plain, text
        comments = [c for t in texts.values() for c in re.findall(r"//([^\n]*)", t)]
        assert all(c.isprintable() and "\\" not in c and "`" not in c and "*/" not in c for c in comments), text
        assert not any(re.match(r"\s*(verilator|synopsys|synthesis|pragma)", c) for c in comments), text


def lint(folder: Path, texts: dict[str, str], top: str) -> str:
    for name, text in (texts | {f.name: f.read_text() for f in block("x").parent.glob("*.v")}).items():
        (folder / name).write_text(text, encoding="utf-8")
    command = ["verilator", "--lint-only", "-Wall", "-Wno-MULTITOP", "--top-module", top, "-y", "."]
    done = subprocess.run(
        [*command, f"{top}.v"], cwd=folder, env=simulator_environment(), capture_output=True, text=True
    )
    return f"{done.returncode}\n{done.stderr}"


@pytest.mark.parametrize("architecture", ["parallel", "folded"])
def test_verilator_finds_nothing_in_the_comments(tmp_path, architecture):
    program = cylinder_program()
    for n, text in enumerate(LEXED):
        (tmp_path / str(n)).mkdir()
        assert lint(tmp_path / str(n), emitted(with_texts(program, text), architecture), "cylinder") == "0\n", text


def test_a_signal_may_be_called_as_a_tool_whose_directives_stand_in_comments(tmp_path):
    program = random_program(5)
    data = json.dumps(to_json(program)).replace(f'"{program.operations[-1].out.name}"', '"verilator_x"')
    (tmp_path / "p.json").write_text(data)
    texts = parallel(Program.load(tmp_path / "p.json"))
    assert "verilator_x" in texts[f"{program.name}.v"]
    assert lint(tmp_path, texts, program.name) == "0\n"


@pytest.mark.parametrize("text", [text for text in HOSTILE if not text.isidentifier()])
def test_a_name_that_verilog_cannot_hold_is_refused_where_it_leaves_too(text):
    program = cylinder_program()
    shown = program.operations[-1].out
    renamed = replace(program.operations[-1], out=replace(shown, name=text))
    for wrong in (
        replace(program, name=text),
        replace(program, tables=tuple(replace(t, name=text) for t in program.tables)),
        replace(program, operations=(*program.operations[:-1], renamed)),
    ):
        for emitter in (parallel, lambda p: folded(p, Design(multipliers=2))):
            with pytest.raises(InputError, match="not a name that Verilog can hold") as refused:
                emitter(wrong)
            assert one_line(refused.value)


def test_verifying_files_whose_comments_hold_commands_runs_none_of_them(tmp_path):
    program = random_program(5)
    (tmp_path / "rtl").mkdir()
    texts = parallel(with_texts(program, INJECTED)) | {f.name: f.read_text() for f in block("x").parent.glob("*.v")}
    for name, text in (texts | {f"{program.name}.f": "\n".join(texts)}).items():
        (tmp_path / "rtl" / name).write_text(text, encoding="utf-8")
    codes = random_codes(program, 0, 5)
    answer = interpret(program, codes)
    scenarios = {"a\nb <&>\x00": Scenario(codes, answer.outputs, answer.states)}
    done = verify_many([Case(program, scenarios, emitted=tmp_path / "rtl")], tmp_path / "out", seed=1)
    assert done.passed
    assert r"a\nb" in done.junit.read_text()
    assert not list(tmp_path.rglob("canary"))


def test_a_remark_is_a_comment_to_the_end_of_its_line():
    assert remark("p_a [Pa], value = code * 2.0 µm") == "// p_a [Pa], value = code * 2.0 µm"
    assert remark("a\nb\\") == "// a?b?"
    assert remark("*/ x /*") == "// * / x / *"
    assert remark("verilator public") == "// - verilator public"
    assert remark("") == "//"


class Tags(HTMLParser):
    """Every tag with the names of its attributes, in order."""

    def __init__(self, text: str):
        super().__init__()
        self.found = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, [name for name, _ in attributes]))

    def handle_endtag(self, tag):
        self.found.append(("/" + tag, []))

    def handle_comment(self, data):
        self.found.append(("!", []))


def renamed_everywhere(value, names: dict):
    """The data with other texts for some, keys too."""
    if isinstance(value, dict):
        return {names.get(k, k): renamed_everywhere(v, names) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [renamed_everywhere(v, names) for v in value]
    return names.get(value, value) if isinstance(value, str) else value


def test_no_text_of_a_study_becomes_a_tag_of_the_report():
    network = random_network(3)
    inputs = {p.name: np.random.default_rng(0).normal(size=(300, p.size)).squeeze() for p in network.inputs}
    r = Record(inputs, {n: y + 0.01 for n, y in network.run(inputs).items()})
    compiled = compile_network(network, {"run": r}, Formats(14), ranged_on=["run"])
    compiled = replace(
        compiled, program=replace(compiled.program, notes={compiled.program.inputs[0].signal.name: "why"})
    )
    found = study("a title", compiled, {"run": r}, ranged_on=["run"], period=1e-3, widths=[14])
    names = {*compiled.program.signals, *found["scenarios"]["run"]["outputs"], "1", "why", "run", "a title", "tansig"}
    names |= {found["program"], *(t["name"] for t in found["tables"])}

    def shown(text: str) -> str:
        poisoned = renamed_everywhere(found, {n: f"{text}{i}" for i, n in enumerate(sorted(names))})
        return page([poisoned], [results([poisoned])])

    plain = Tags(shown("plain")).found
    assert len(plain) > 500
    for text in HOSTILE:
        assert Tags(shown(text)).found == plain, text


def test_no_text_of_a_validation_becomes_a_tag_or_ends_a_script():
    network, records = linear(), {"train": record(400, equation_noise=0.1)}
    validations = validate(network, records, period=1e-2, horizons=(1,))
    ranges = coverage(network, records, ("train",))

    def shown(text: str) -> str:
        tests = {
            k: [replace(t, name=f"{t.name.split()[0]} {text}") for t in ts] for k, ts in validations[0].tests.items()
        }
        v = replace(validations[0], record=text, output=text, unit=text, tests=tests)
        named = [replace(r, signal=text, unit=text, record=text) for r in ranges]
        return validation_page(Judged(text, text, 3, 1e-2, (text,), [v], named))

    without_plotly = re.compile(r'<script type="text/plain" id="plotly">.*?</script>', re.S)
    plain = Tags(without_plotly.sub("", shown("plain"))).found
    assert len(plain) > 100
    for text in HOSTILE:
        html = without_plotly.sub("", shown(text))
        assert Tags(html).found == plain, text
        data = re.search(r'<script type="application/json">(.*?)</script>', html, re.S)[1]
        assert "<" not in data
        assert "<" not in json.loads(data)["labels"][0]  # Plotly takes it as HTML


def test_no_text_of_a_drawing_becomes_a_tag():
    signal = {"fix": "Fix(8, 4)", "width": 8, "frac": 4, "observed": (-1.0, 1.0), "sound": (-2.0, 2.0)}
    signal |= {"quantiles": [0.1, 0.2, 0.3, 0.4, 0.5], "saturations": {}}

    def drawn(text: str) -> str:
        line = Curve([0.0, 1.0], [0.0, 1.0], "fixed")
        chart = figures.chart([line], x=text, y=text, levels=[(0.5, text)])
        formats = figures.formats([signal | {"name": text}])
        changes = figures.weight_changes({f"{text}.layer.{text}": np.array([1.0, np.nan])})
        rivals = {text: 1.0, "nothing": 3.0}
        ladder = draw_ladder(SimpleNamespace(rivals=rivals, verdict="explained", best=text))
        return f"{chart}{formats}{changes}{ladder}"

    plain = Tags(drawn("plain")).found
    for text in HOSTILE:
        assert Tags(drawn(text)).found == plain, text


def test_no_template_takes_text_as_it_stands():
    templates = list(Path(pages.__file__).parent.glob("**/*.html"))
    assert len(templates) >= 4
    for template in templates:
        assert not re.search(r"\|\s*safe|autoescape", template.read_text()), template
