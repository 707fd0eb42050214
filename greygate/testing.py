"""For tests of your own under pytest: a build as a fixture, and that its Verilog computes what its emulator computes.

pytest finds `greygate_build` by itself, as a plugin. It loads greygate only when a test asks for a build.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from greygate.hardware.build import Project


@pytest.fixture(scope="session")
def greygate_build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., "Project"]:
    """A function that compiles a network into a folder of pytest's, the same request once in a session.

    `greygate_build("mine.toml", {"train": "train.csv"}, width=14)`: a network as `greygate compile` takes it; scenario
    -> recording, which set the ranges; `width` and `finer` of the formats, and the options of
    `greygate.build`. It returns a `greygate.Project` and raises InputError as `greygate.build`.
    """
    made: dict[str, Project] = {}

    def build(network: object, recordings: Mapping[str, object] | None = None, **options: Any) -> "Project":
        from greygate.hardware.build import Project
        from greygate.machines.source import Source
        from greygate.project import compile_project

        request = repr((str(network), recordings, sorted(options.items())))
        if request not in made:
            source = Source(str(network), {name: str(path) for name, path in (recordings or {}).items()})
            sizes = {name: options.pop(name) for name in ("width", "finer") if name in options}
            if sizes:
                options["formats"] = source.formats(**sizes)
            folder = tmp_path_factory.mktemp("greygate") / "build"
            compile_project(source, folder, **options)
            made[request] = Project.open(folder)
        return made[request]

    return build


def assert_bits_equal(project: "Project", *scenarios: str, seed: int | None = None, as_is: bool = False) -> None:
    """Simulate every design of a build, and fail if a bit of a step differs from the emulator.

    scenarios: those of the build, all if none is named. seed: of resets and pauses, drawn if not given. as_is: Verilog
    that you have changed, too. The failure names design, scenario, step and signal, the seed that plays it again, and
    a waveform of that step. Raises InputError as `greygate.verify`.
    """
    __tracebackhide__ = True
    from greygate.project import verify_project

    wrong = []
    for design, found in verify_project(project, scenarios, seed, as_is).items():
        wrong += [
            f"{design}, {verdict.scenario} (seed {found.seed}): {verdict.mismatch}"
            for verdict in found.verdicts
            if verdict.mismatch is not None
        ]
        wrong += [] if found.waveform is None else [f"waveform: {found.waveform}"]
    if wrong:
        pytest.fail("\n".join([f"{project.folder}: the Verilog differs from the emulator", *wrong]), pytrace=False)
