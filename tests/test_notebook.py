"""Results show themselves in a notebook, in a frame that keeps its style and runs no script."""

import ast
import html
import re

import pytest
from networks import delay_line
from test_cli import recording

from greygate import Network, Project, children, diagnose, load_rig
from greygate.machines.samples import write
from greygate.pages import figures, notebook


def page(shown: str) -> str:
    assert shown.startswith('<iframe srcdoc="')
    assert shown.endswith(" sandbox></iframe>")
    return html.unescape(shown.partition('srcdoc="')[2].partition('"')[0])


def test_a_network_shows_its_answer_to_a_step_and_its_layers():
    network = delay_line()
    found = page(notebook.network(network))
    assert found.count("<svg class") == len(network.inputs)
    assert found.count("<tr>") == 1 + len(network.layers())


def test_a_build_shows_what_its_hardware_answers_and_its_formats(greygate, tmp_path):
    delay_line().save(tmp_path / "line")
    recording(tmp_path / "run.csv", steps=200)
    assert greygate("compile", tmp_path / "line.toml", tmp_path / "run.csv", "--out", tmp_path / "line")[0] == 0
    project = Project.open(tmp_path / "line")
    found = page(notebook.project(project))
    assert found.count('class="line fixed"') == 2 * len(project.program.outputs)  # its values, and its words
    assert found.count('class="line model"') == len(project.program.inputs)
    assert all(str(p.signal.fix) in found for p in project.program.inputs)


def test_a_diagnosis_shows_its_verdict_and_its_errors(tmp_path):
    write("plant", tmp_path)
    found = page(notebook.diagnosis(diagnose(load_rig(tmp_path / "axis"))))
    assert "missing physics" in found
    assert "spring" in found
    assert "140.3 mm" in found
    assert "<script" not in found


def test_figures_of_an_axis_are_told_apart_and_stand_beside_its_name():
    large = [270_000_000.0, 271_000_000.0, 271_500_000.0]
    drawn = figures.chart([figures.Curve(range(3), large, "model")], x="step", y="p_a")
    places = re.findall(r'class="tick" x="([\d.]+)" y="[^"]+" text-anchor="end">([^<]+)', drawn)
    assert len({label for _, label in places}) == len(places) > 1
    assert all(float(x) - figures.DIGIT * len(label) >= 14 for x, label in places)


def test_a_name_is_no_html():
    assert "<b>" not in page(notebook.network(Network("a<b>x</b>")))


CELLS = """
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
assert shell.run_cell("import greygate; found = greygate.Network('x')").success
print(shell.display_formatter.format(shell.user_ns["found"])[0]["text/html"])
"""


def test_a_notebook_that_imports_greygate_draws_its_results():
    pytest.importorskip("IPython")
    assert "Network x" in page(children.ran(children.python("-c", CELLS)).stdout.strip())


TRAINED = """
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
import contextlib, io, numpy, greygate
from greygate.models.families.regression import noe
lag = noe("lag", {greygate.Port("u", "V"): (1,)}, greygate.Port("y", "m"), (1,), hidden=2)
u = numpy.sin(numpy.arange(200.0))
record = greygate.Record({"u": u}, {"y": numpy.roll(u, 1)})
for options in ({"progress": lambda line: None}, {}):
    with contextlib.redirect_stdout(io.StringIO()) as told:
        greygate.train(lag, record, epochs=3, **options)
    print(repr(told.getvalue()))
"""


def test_training_in_a_notebook_says_where_it_is_on_one_line():
    pytest.importorskip("IPython")
    done = children.ran(children.python("-c", TRAINED))
    silent, told = map(ast.literal_eval, done.stdout.splitlines())
    assert silent == ""
    assert told.count("\repoch ") == 3
    assert "\n" not in told
