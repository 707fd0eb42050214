"""Every page in a real browser: telephone, tablet, desk and paper, light and dark, by mouse and by keyboard."""

from pathlib import Path

import browsing
import numpy as np
import pytest
import test_report as small
from networks import delay_line
from test_cli import recording

from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.study import study
from greygate.mismatch import rig
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.diagnose import diagnose
from greygate.models.families.regression import noe
from greygate.models.network import Port
from greygate.pages import changes as changed
from greygate.pages.diagnosis import page as diagnosis_page
from greygate.pages.report import page as report_page

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(bool(browsing.missing()), reason=f"a browser needs {browsing.missing()}"),
]
SITE = Path(__file__).parents[1] / "build" / "site"
PAGE = """<!doctype html><html lang=en><meta name=viewport content='width=device-width'><title>x</title>
<main>{}</main></html>"""


@pytest.fixture(scope="module")
def browser():
    with browsing.chromium() as found:
        yield found


@pytest.fixture
def build(greygate, tmp_path):
    """A folder with `line.toml`, a recording, and the build `line`."""
    delay_line().save(tmp_path / "line")
    recording(tmp_path / "run.csv", steps=200)
    assert greygate("compile", tmp_path / "line.toml", tmp_path / "run.csv", "--out", tmp_path / "line")[0] == 0
    return tmp_path


def report(greygate, folder):
    assert greygate("report", folder / "line", "--html", folder / "page.html")[0] == 0


def compare(greygate, folder):
    words = [folder / "run.csv", "--width", "8", "--out", folder / "coarse"]
    assert greygate("compile", folder / "line.toml", *words)[0] == 0
    assert greygate("compare", folder / "line", folder / "coarse", "--html", folder / "page.html")[0] == 1


def validate(greygate, folder):
    words = [folder / "run.csv", "--out", folder / "page.html"]
    assert greygate("validate", folder / "line.toml", *words)[0] == 0


def look(greygate, folder):
    assert greygate("look", folder / "run.csv", "--html", folder / "page.html")[0] == 0


def diagnosis(greygate, folder):
    concealed = conceal("cable_drum", 3, folder / "case", effect="speed_slip", kind="one")
    (folder / "page.html").write_text(diagnosis_page(diagnose(rig.load(concealed))))


def train(greygate, folder):
    noe("lag", {Port("u", "V"): (1,)}, Port("y", "m"), (1,), hidden=2).save(folder / "lag")
    words = [folder / "run.csv", "--tail", "0.3", "--seeds", "2", "--epochs", "5"]
    assert greygate("train", folder / "lag.toml", *words, "--out", folder, "--html", folder / "page.html")[0] == 0


def changes(greygate, folder):
    changed.draw_changes(delay_line(), delay_line(), folder / "page.html")


@pytest.mark.parametrize("made", [report, compare, validate, look, diagnosis, train, changes])
def test_a_page_is_right_in_every_size_and_theme_on_paper_and_by_keyboard(made, greygate, build, browser):
    made(greygate, build)
    found = browsing.faults(browser, build / "page.html")
    assert len(found) == 9
    assert found == {where: [] for where in found}


WRONG = {
    "px wider than the window": "<div style='width:1500px'>wide</div>",
    "contrast 1.0": "<p style='color:white'>white on white</p>",
    'class "line gone" cannot be seen': "<svg fill=none><path class='line gone' d='M0 0H1H2H3H4H5H6H7H8H9'/></svg>",
    "1.0 px is the size of": "<svg width=10 viewBox='0 0 100 100'><text font-size=10 y=50>tiny</text></svg>",
    "stands over": "<svg width=99><text y=20>one</text><text y=22>two</text></svg>",
    "console error: bad": "<script>console.error('bad')</script>",
    "error: gone is not defined": "<script>gone()</script>",
    "http://127.0.0.1:9/x.png": "<img src='http://127.0.0.1:9/x.png' alt=x>",
    "have no frame": "<a href='#x' style='outline:none'>x</a>",
    "Tab reaches": "<button>a</button><button tabindex=-1>b</button>",
}  # fmt: skip


@pytest.mark.parametrize("said", WRONG)
def test_what_is_wrong_is_seen(said, browser, tmp_path):
    (tmp_path / "page.html").write_text(PAGE.format(WRONG[said]))
    assert said in str(browsing.faults(browser, tmp_path / "page.html"))


def test_a_page_without_a_fault_has_none(browser, tmp_path):
    (tmp_path / "page.html").write_text(PAGE.format("<p>x</p><a href='#y'>y</a>"))
    assert not any(browsing.faults(browser, tmp_path / "page.html").values())


def test_a_drop_down_leaves_one_output_on_the_screen_and_paper_has_all(browser, tmp_path):
    records = {"training": small.record(1, 300)}
    compiled = compile_network(small.network(), records, Formats(14), period=small.PERIOD)
    found = study("small", compiled, records, ranged_on=["training"], period=small.PERIOD, widths=())
    (tmp_path / "page.html").write_text(report_page([found]))
    with browsing.opened(browser, tmp_path / "page.html", browsing.SIZES["desk"], "light") as (tab, told):
        seen = "[...document.querySelectorAll('[data-output]')].filter(e => e.offsetWidth).map(e => e.dataset.output)"
        everything = ["x", "p[0]", "p[1]"]
        assert tab.evaluate(seen) == everything
        tab.focus(".choice select")
        for shown in ([name] for name in everything):
            tab.keyboard.press("ArrowDown")
            tab.wait_for_function(f"{seen}.join() === '{shown[0]}'")
        tab.emulate_media(media="print")
        assert tab.evaluate(seen) == everything
        assert told == []


def test_keys_zoom_move_and_return(greygate, build, browser):
    look(greygate, build)
    with browsing.opened(browser, build / "page.html", browsing.SIZES["desk"], "light") as (tab, told):

        def pressed(key):
            tab.keyboard.press(key)
            tab.wait_for_timeout(browsing.SETTLED)
            return np.array(tab.evaluate("document.querySelector('.plot').layout.xaxis.range"))

        tab.focus(".plot")
        whole = pressed("x")
        near = pressed("+")
        assert np.ptp(near) == pytest.approx(np.ptp(whole) / 2)
        assert near.mean() == pytest.approx(whole.mean())
        assert pressed("ArrowRight") == pytest.approx(near + np.ptp(near) / 4)
        assert np.ptp(pressed("-")) == pytest.approx(np.ptp(whole))
        assert pressed("0") == pytest.approx(whole)
        assert told == []


@pytest.mark.skipif(not SITE.exists(), reason="the site is not built: make docs")
def test_the_site_is_searched_without_a_server(browser):
    with browsing.opened(browser, SITE / "training.html", browsing.SIZES["desk"], "light") as (tab, told):
        tab.keyboard.press("s")
        tab.keyboard.type("levenberg", delay=20)
        tab.wait_for_selector(".md-search-result__item a[href*='training.html']")
        assert told == []
