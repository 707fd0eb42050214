"""The C99 target: every bit of the emulator, on every compiler here, with sanitizers silent."""

import shutil
import subprocess
import tempfile

import numpy as np
import pytest
from legal_programs import legal_codes, legal_program
from programs import cylinder_program

from greygate.compiler.emit import emit
from greygate.compiler.targets import c99
from greygate.emulator.interpreter import interpret
from greygate.hardware.build import Project
from greygate.machines.catalog import REPORTED
from greygate.machines.source import Source
from greygate.project import compile_project

CHECKED = 20  # random legal programs
STEPS = 60
SHOWN = 3000  # steps of a machine's scenario, for the sanitizers are slow
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow", "-Werror")
STRICT = ("-std=c99", *WARNINGS, "-fsanitize=undefined,address", "-fno-sanitize-recover=all")


def complete(compiler: str) -> bool:
    """Is it here, with its sanitizers? Debian's clang comes without them where recommended packages are left out."""
    if not shutil.which(compiler):
        return False
    with tempfile.TemporaryDirectory() as folder:
        words = [compiler, *STRICT, "-x", "c", "-", "-o", f"{folder}/none"]
        return not subprocess.run(words, input=b"int main(void) { return 0; }", capture_output=True).returncode


COMPILERS = [name for name in ("gcc", "clang") if complete(name)]
ALL = [
    pytest.param(name, marks=pytest.mark.skipif(name not in COMPILERS, reason=f"{name} or its sanitizers are missing"))
    for name in ("gcc", "clang")
]
HARNESS = """
#include <stdio.h>
static long counts[{operations}];
#define {upper}_SATURATED(n) (counts[n]++)
#include "{name}.c"
int main(void)
{{
    static {name}_state state;
    static {name}_input in;
    static {name}_output out;
    int64_t codes[{columns}];
    {name}_reset(&state);
    while (fread(codes, sizeof codes, 1, stdin) == 1)
    {{
{read}
        {name}_step(&state, &in, &out);
{write}
    }}
    for (int n = 0; n < {operations}; n++) fprintf(stderr, "%ld\\n", counts[n]);
    return 0;
}}
"""


def fields(prefix, ports):
    """(C field, element) for each column, by the names that the header shows."""
    names = c99.identifiers(prefix, (p.name for p in ports))
    return [(names[p.name], p.signal, r) for p in ports for r in range(p.signal.size)]


def built(program, folder, compiler="gcc", level="-O2"):
    """Compile the C of the program, alone and with a harness; return the harness, which no sanitizer stops."""
    emit(program, folder, "c99")
    read = [
        f"in.{f}[{r}] = ({c99.integer(s.fix)})codes[{k}];" for k, (f, s, r) in enumerate(fields("in_", program.inputs))
    ]
    write = [
        f"{{ int64_t y = out.{f}[{r}]; fwrite(&y, 8, 1, stdout); }}" for f, _, r in fields("out_", program.outputs)
    ]
    text = HARNESS.format(
        name=program.name,
        upper=program.name.upper(),
        operations=len(program.operations),
        columns=len(read),
        read="\n".join(read),
        write="\n".join(write),
    )
    (folder / "harness.c").write_text(text)
    harness = folder / f"{compiler}{level}"
    alone = [compiler, *STRICT, level, "-fsyntax-only", f"{program.name}.c"]  # the harness compiles it, too
    for command in (alone, [compiler, *STRICT, level, "harness.c", "-o", harness]):
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    return harness


def same(program, codes, want, harness):
    """Every output of the harness, and every count of saturations, is that of the emulator."""
    done = subprocess.run([harness], input=codes.astype(np.int64).tobytes(), capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    np.testing.assert_array_equal(np.frombuffer(done.stdout, np.int64).reshape(want.outputs.shape), want.outputs)
    counts = dict(zip((o.out.name for o in program.operations), map(int, done.stderr.split()), strict=True))
    assert {name: counts[name] for name in want.saturations} == want.saturations


def agree(program, codes, folder, compiler="gcc", level="-O2"):
    same(program, codes, interpret(program, codes), built(program, folder, compiler, level))


@pytest.mark.parametrize("seed", range(CHECKED))
def test_a_random_legal_program_gives_the_bits_of_the_interpreter(seed, tmp_path):
    program = legal_program(seed, f"random{seed}")
    compiler, level = COMPILERS[seed % len(COMPILERS)], ("-O0", "-O2")[seed // 2 % 2]
    agree(program, legal_codes(program, seed, STEPS), tmp_path, compiler, level)


@pytest.mark.parametrize("level", ["-O0", "-O2"])
@pytest.mark.parametrize("compiler", ALL)
def test_every_compiler_at_every_level_gives_the_same_bits(compiler, level, tmp_path):
    program = cylinder_program()
    agree(program, legal_codes(program, 3, STEPS), tmp_path, compiler, level)


@pytest.mark.parametrize("name", [REPORTED[0], *(pytest.param(n, marks=pytest.mark.nightly) for n in REPORTED[1:])])
def test_a_machine_of_the_thesis_gives_the_same_bits(name, tmp_path):
    compile_project(Source(name), tmp_path / "build", architectures=("c99",))
    project = Project.open(tmp_path / "build")
    scenario = next(iter(project.source.scenarios))
    codes = project.program.encode(project.source.records()[scenario].inputs)[:SHOWN]
    agree(project.program, codes, tmp_path)


def test_names_that_c_cannot_hold_are_changed_and_stay_apart():
    assert c99.identifiers("v_", ["a.b", "a_b", "int", "a.b_2"]) == {
        "a.b": "v_a_b", "a_b": "v_a_b_2", "int": "v_int", "a.b_2": "v_a_b_2_2",
    }  # fmt: skip


def test_the_command_writes_it(greygate, tmp_path):
    code, _, _ = greygate("compile", "b2", "--architecture", "c99", "--out", tmp_path / "b")
    assert code == 0
    assert sorted(p.name for p in (tmp_path / "b/rtl/c99").iterdir()) == ["b2.c", "b2.h"]
