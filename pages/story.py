"""The page of `greygate make`: what each step found, with the pictures of that step's own page."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from markupsafe import Markup

from greygate.compiler.study import Explored
from greygate.hardware.controlled import Controlled
from greygate.mismatch.diagnosis import Diagnosis
from greygate.pages import templates
from greygate.pages.diagnosis.residual import Diagnosed
from greygate.pages.diagnosis.sections import evidence, maps, numbers, runs, signals, where
from greygate.pages.recorded import drawings
from greygate.pages.report import sections as report
from greygate.pages.units import display, number
from greygate.pages.validation.judged import Judged
from greygate.pages.validation.sections import facts, ranges, records
from greygate.plants.readers.columns import Channel
from greygate.plants.recording import Recording

WHO = {"nominal": "data sheet", "corrected": "diagnosed plant", "linear": "linear model", "network": "network"}
Facts = Mapping[str, Mapping[str, Mapping[str, float | None]]]


def page(title: str, steps: Sequence[Mapping]) -> str:
    """One self-contained HTML page. steps: name, title, figure, file, seconds, yes, picture."""
    return templates.render("story.html", title=title, steps=steps, plotly=templates.plotly())


def recorded(recording: Recording) -> Markup:
    """Every channel of a recording."""
    channels = [Channel(n, recording.units[n], recording.time, v) for n, v in recording.channels.items()]
    return templates.render("channels.html", **drawings(channels))


def diagnosed(result: Diagnosis) -> tuple[Markup, Markup]:
    """(what is recorded and what is simulated, with the evidence; the errors before and after, with the figures)."""
    case = Diagnosed(result)
    found, fitted = (
        [*templates.render_sections(each, case)] for each in ((signals, where, maps, evidence), (runs, numbers))
    )
    return Markup("").join(found), Markup("").join(fitted)


def built(rms: Facts, units: Mapping[str, str], decisions: Sequence[Mapping]) -> Markup:
    """The errors of a network beside those of its rivals, and what was decided. rms: of build-snn."""
    rows = []
    for recording, outputs in rms["network"].items():
        for output in outputs:
            errors = {who: rms[who][recording][output] for who in WHO}
            largest = max((e for e in errors.values() if e is not None), default=0.0)
            rows += [_error(recording, output, who, e, largest, units[output]) for who, e in errors.items()]
    return templates.render("built.html", rows=rows, decisions=decisions)


def _error(recording: str, output: str, who: str, error: float | None, largest: float, unit: str) -> dict:
    factor, label = display(unit, error or 0.0)
    share = 100.0 if error is None else 100.0 * error / (largest or 1.0)
    rms = "∞" if error is None else number(factor * error)
    return {"recording": recording, "output": output, "of": WHO[who], "rms": rms, "unit": label or "1",
            "share": f"{share:.2f}"}  # fmt: skip


def validated(judged: Judged, held: Collection[str]) -> Markup:
    """The free run and the tests on what was held out."""
    fresh = replace(judged, validations=[v for v in judged.validations if v.record in held])
    head = templates.render("facts.html", facts=facts(fresh))
    return head + Markup("").join(templates.render_sections((records, ranges), fresh))


def compiled(found: Explored) -> Markup:
    """The designs that were worth having, and the one that was chosen."""
    return Markup("").join(templates.render_sections((report.explored,), {"explored": found}))


def verified(study: dict, held: Collection[str]) -> Markup:
    """The run of the hardware on what was held out, beside float and what was recorded."""
    fresh = {**study, "scenarios": {n: s for n, s in study["scenarios"].items() if n in held}}
    return Markup("").join(templates.render_sections((report.head, report.runs), fresh))


def controlled(found: Controlled, nominal: Recording) -> Markup:
    """The errors of every controller by what disturbs, and the signals of the last one undisturbed."""
    rows = []
    for name, cases in found["rows"].items():
        for output, unit in found["units"].items():
            runs = [run["errors"][output] for run in cases.values()]
            factor, label = display(unit, max(run["worst"] for run in runs))
            errors = [" / ".join(_finite(factor * run[of]) for of in ("rms", "worst")) for run in runs]
            broken = sum(sum(run["limits"].values()) for run in cases.values())
            rows.append({"by": name, "output": f"{output} [{label or 1}]", "errors": errors, "broken": broken})
    disturbed = [*next(iter(found["rows"].values()))]
    return templates.render("controlled.html", rows=rows, cases=disturbed) + recorded(nominal)


def _finite(value: float) -> str:
    return number(value) if math.isfinite(value) else "∞"
