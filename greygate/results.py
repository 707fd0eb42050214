"""Every result that a command prints with --json, and every JSON file that greygate writes, with the type of each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """declared: MODULE:TYPE below greygate. marked: whether it says in `schema` what it is.

    file: the same object is the content of a file as well, which has no `schema`, nor these fields.
    """

    title: str
    declared: str
    marked: bool = True
    file: tuple[str, ...] | None = None
    version: int = 1


_CONCEALED = "mismatch.concealed.printed"
RESULTS = {
    "augment": Result("greygate augment --json, augment.json", "mismatch.augment:Augmented", file=()),
    "bench-concealed-make": Result("greygate dev bench-concealed make --json", "cli.printed:BenchMade"),
    "bench-concealed-run": Result("greygate dev bench-concealed run --json", "cli.printed:BenchRun"),
    "bench-concealed-score": Result("greygate dev bench-concealed score --json", f"{_CONCEALED}:Scores", False),
    "board": Result("greygate board --json, board.json", "hardware.board.make:BoardFacts", file=("folder",)),
    "build": Result("compile.json of a build", "project:Facts", False),
    "build-snn": Result(
        "greygate build-snn --json, and NAME.json beside the network",
        "identify.expert.files:BuiltFacts",
        file=("better", "seconds", "neurons", "out", "next"),
    ),
    "catalogue": Result("greygate train list --json, greygate control list --json", "cli.printed:Catalogue", False),
    "catalogue-training": Result(
        "greygate train NAME --json, and NAME.json in the folder", "cli.printed:CatalogueTraining", False
    ),
    "ci-template": Result("greygate ci-template --json", "export.ci:Workflow"),
    "commitment": Result("commitment.json of the blind benchmark", f"{_CONCEALED}:Commitment", False),
    "compare": Result("greygate compare --json", "cli.printed:Comparing"),
    "compile": Result("greygate compile --json", "cli.printed:Compiling"),
    "conceal": Result("greygate dev conceal --json", "cli.printed:Concealing"),
    "concealed-answer": Result("answer.json of the blind benchmark", f"{_CONCEALED}:AnswerFile", False),
    "concealed-run": Result("run.json of the blind benchmark", f"{_CONCEALED}:Ran", False),
    "control": Result("greygate control MACHINE --json", "cli.printed:Controlling"),
    "diagnosis": Result("greygate diagnose --json, diagnosis.json", "mismatch.printed:Diagnoses", False, version=2),
    "doctor": Result("greygate doctor --json", "cli.printed:Doctor"),
    "emulate": Result("greygate emulate --json", "cli.printed:Emulating"),
    "explored": Result(
        "greygate explore --json, where no design meets the request (exit code 1)",
        "compiler.explore.printed:Explored",
    ),
    "export-c": Result("greygate export c --json", "cli.printed:ExportedC"),
    "export-fmu": Result("greygate export fmu --json", "export.export:ExportedFmu"),
    "export-fusesoc": Result("greygate export fusesoc --json", "export.hdl:ExportedCore"),
    "export-latex": Result("greygate export latex --json", "cli.printed:ExportedLatex"),
    "export-mjcf": Result("greygate export mjcf --json", "cli.printed:ExportedMjcf"),
    "export-modelica": Result("greygate export modelica --json", "cli.printed:ExportedModelica"),
    "fit-fmu": Result("greygate fit-fmu --json", "export.calibrate:Calibrated"),
    "identify": Result(
        "greygate identify --json, and NAME.json beside the network",
        "identify.files:IdentifiedFacts",
        file=("out", "next"),
    ),
    "init": Result("greygate init --json", "identify.starting:NetworkStart"),
    "init-rig": Result("greygate init-rig --json", "mismatch.starting:RigStart"),
    "isolability": Result("greygate isolability --json", "mismatch.experiments.isolability:Isolated"),
    "look": Result("greygate look --json", "cli.printed:Looking"),
    "manifest": Result("manifest.json of a folder that greygate wrote", "files:Manifest", False),
    "next": Result("greygate next --json", "mismatch.experiments.proposal:Proposed"),
    "play": Result("greygate play --json", "cli.printed:Playing"),
    "program": Result("program.json of a build", "emulator.program:Program", False),
    "prove": Result("greygate prove --json", "cli.printed:Proving"),
    "report": Result("greygate report --json, report.json", "compiler.study:Studies", False),
    "resources": Result("greygate synthesize --json, resources.json", "hardware.synthesis:Resources", False),
    "reveal": Result("greygate dev reveal --json", "cli.printed:Reveal"),
    "sealed-answer": Result("sealed.json of greygate dev conceal", f"{_CONCEALED}:Sealed", False),
    "simulate": Result("greygate simulate --json", "cli.printed:Simulating"),
    "train": Result(
        "greygate train NAME.toml --json, and NAME.json beside the trained network",
        "identify.training:Training",
        file=("out",),
    ),
    "validate": Result("greygate validate --json", "pages.validation.judged:ValidationFigures"),
    "verified": Result("verify.json of a build", "compiler.study:Verifications", False),
    "verify": Result("greygate verify --json", "cli.printed:Verifying"),
    "vocabulary": Result("vocabulary.json of the blind benchmark", f"{_CONCEALED}:Vocabulary", False),
}
