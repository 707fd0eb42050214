"""A diagnosis with its evidence in pictures: one self-contained HTML page (docs/diagnosis.md)."""

from datetime import date

from greygate.mismatch.diagnosis import Diagnosis
from greygate.pages import templates
from greygate.pages.diagnosis.residual import Diagnosed
from greygate.pages.diagnosis.sections import evidence, head, maps, numbers, runs, where
from greygate.version import __version__

SECTIONS = (head, runs, where, maps, evidence, numbers)


def page(result: Diagnosis) -> str:
    """The page of a diagnosis."""
    case = Diagnosed(result)
    title, sections = f"greygate diagnosis: {case.title}", templates.render_sections(SECTIONS, case)
    command = f"greygate diagnose {result.rig.folder}"
    made = f"greygate {__version__}, {command}, {date.today()}, {case.found['seconds']:.1f} s"
    return templates.render("diagnosis/page.html", title=title, sections=sections, plotly=templates.plotly(), made=made)
