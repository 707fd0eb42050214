"""Every kind of page, of real machines, and the documentation's site, in Chromium: sizes x themes, paper, keyboard.

Draws the pictures of docs/browser.md. Exit code 1 if a page has a fault of tests/browsing.py. On the site, which `make
docs` builds and whose theme is not ours, console, requests and width are looked at.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import product
from pathlib import Path
from threading import Thread

import browsing

from .made import ROOT, keep
from .shared import GREYGATE, VERILATOR, scratch

TAKES = "five minutes"
NEEDS = VERILATOR
SITE = ROOT / "build" / "site"
PICTURES = ROOT / "docs" / "pictures"
SHOWN = {
    "report": ("desk", "light"),
    "diagnosis": ("desk", "dark"),
    "validate": ("tablet", "light"),
    "look": ("telephone", "dark"),
    "train": ("desk", "light"),
}


def greygate(*words: object, folder: Path, code: int = 0) -> None:
    done = subprocess.run([GREYGATE, *map(str, words)], cwd=folder, capture_output=True, text=True)
    if done.returncode != code:
        sys.exit(f"greygate {' '.join(map(str, words))}: exit code {done.returncode}\n{done.stderr}")


def pages(folder: Path) -> dict[str, Path]:
    """Make one page of each kind; which command -> page."""
    greygate("compile", "valve_cylinder", "--out", "whole", folder=folder)
    greygate("compile", "valve_cylinder", "--prune", "1.0", "--out", "pruned", folder=folder)
    greygate("verify", "pruned", folder=folder)
    greygate("report", "pruned", "--html", "report.html", folder=folder)
    greygate("compare", "whole", "pruned", "--html", "compare.html", folder=folder, code=1)
    greygate("validate", "valve_cylinder", "--html", "validate.html", folder=folder)
    recording = ROOT / "recordings" / "servohydraulic-mts" / "mts_15Hz0A.csv"
    greygate("look", recording, "--html", "look.html", folder=folder)
    greygate("init", recording, "--input", "x_cmd", "--output", "x_meas", "--out", "mine", folder=folder)
    words = [recording, "--tail", 0.2, "--seeds", 3, "--epochs", 20]
    greygate("train", "mine.toml", *words, "--out", "trained", "--html", "train.html", folder=folder)
    words = ["--seed", 3, "--kind", "one", "--effect", "speed_slip", "--out", "case"]
    greygate("dev", "conceal", "cable_drum", *words, folder=folder)
    greygate("diagnose", "case", "--html", "diagnosis.html", folder=folder)
    greygate("look", recording, "--against", "trained/mine.toml", "--html", "models.html", folder=folder)
    words = [recording, "--input", "x_cmd", "--output", "x_meas", "--seconds", 20]
    greygate("identify", *words, "--out", "found", "--html", "identify.html", folder=folder)
    names = ("report", "compare", "validate", "look", "models", "train", "identify", "diagnosis")
    return {name: folder / f"{name}.html" for name in names}


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a server of this folder."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    class Patient(ThreadingHTTPServer):
        def handle_error(self, *_):  # a page that is left ends its downloads
            pass

    with Patient(("127.0.0.1", 0), partial(Quiet, directory=folder)) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def of_site(browser, page: str) -> list[str]:
    wrong = []
    for (name, size), theme in product(browsing.SIZES.items(), browsing.THEMES):
        with browsing.opened(browser, page, size, theme) as (tab, told):
            wider = tab.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            wrong += [f"{name}, {theme}: {what}" for what in told + [f"{wider} px too wide"] * (wider > 0)]
    return wrong


def main() -> int:
    if browsing.missing():
        sys.exit(f"missing: {browsing.missing()}")
    if not SITE.exists():
        sys.exit(f"{SITE} is not there: make docs")
    rows = []
    with scratch() as folder, browsing.chromium() as browser:
        for name, page in pages(folder).items():
            found = browsing.faults(browser, page)
            wrong = [f"{where}: {what}" for where, all_ in found.items() for what in all_]
            rows.append({"page": f"greygate {name}", "pages": 1, "opened": len(found), "faults": wrong})
            rows[-1]["bytes"] = page.stat().st_size
            print(rows[-1], flush=True)
            if name in SHOWN:
                size, theme = SHOWN[name]
                with browsing.opened(browser, page, browsing.SIZES[size], theme) as (tab, _):
                    tab.screenshot(path=PICTURES / f"page_{name}.png")
        site = sorted(SITE.rglob("*.html"))
        with served(SITE) as home:
            names = [page.relative_to(SITE).as_posix() for page in site]
            wrong = [f"{name}: {what}" for name in names for what in of_site(browser, f"{home}/{name}")]
        times = len(site) * len(browsing.SIZES) * len(browsing.THEMES)
        rows.append({"page": "the documentation's site", "pages": len(site), "opened": times, "faults": wrong})
        print(rows[-1])
        keep("browser", "pages", {"browser": browser.version, "rows": rows})
    return any(row["faults"] for row in rows)
