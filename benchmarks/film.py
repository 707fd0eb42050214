"""`greygate app` by mouse alone, from nothing to a named effect and to verified Verilog, as a film of 30 s.

Draws docs/pictures/app.webp of docs/browser.md: what is clicked is framed; while something runs, seconds are left out.
"""

import io
import time

import browsing
from PIL import Image

from greygate import children

from .made import ROOT
from .shared import VERILATOR, scratch

TAKES = "three minutes"
THREADS = "all"
NEEDS = VERILATOR
FILM = ROOT / "docs" / "pictures" / "app.webp"
SIZE = (960, 640)  # px
SECONDS = 30  # of the film
STEP = 12.0  # s between two frames while something runs
PATIENCE = 600.0  # s until what runs is done
WAY = (  # (what is clicked, what is then waited for)
    ("text=Try recording", "button:text-is('Diagnose')"),
    ("button:text-is('Diagnose')", "#verdict:has-text('missing physics: speed_slip')"),
    ("nav >> text=folder", "text=Try network"),
    ("text=Try network", "text=Find a network"),
    ("fieldset:has(legend:text-is('x_cmd')) >> text=drives", ""),
    ("fieldset:has(legend:text-is('x_meas')) >> text=is predicted", ""),
    ("text=Find a network", "a.go:text-is('Network to FPGA')"),
    ("a.go:text-is('Network to FPGA')", "button:text-is('Compile')"),
    ("button:text-is('Compile')", "button:text-is('Verify')"),
    ("button:text-is('Verify')", "#verdict:has-text('every bit is equal')"),
)
EFFECT = 2  # clicks until the effect is named
QUALITY = 35  # of 100, of WebP
SCROLL = "y => { const e = document.querySelector('iframe'); scrollTo(0, e ? e.offsetTop - 90 + y : y); }"


class Film:
    """The frames of a tab, each once."""

    def __init__(self, tab):
        self.tab, self.frames = tab, list[Image.Image]()

    def take(self) -> None:
        found = Image.open(io.BytesIO(self.tab.screenshot())).convert("RGB")
        if found not in self.frames[-1:]:
            self.frames.append(found)

    def click(self, what: str, then: str) -> None:
        place = self.tab.locator(what).first
        place.scroll_into_view_if_needed()
        place.evaluate("e => { e.style.outline = '4px solid #d55e00'; }")
        self.take()
        place.click()
        ends = time.monotonic() + PATIENCE
        while then and not self.tab.locator(then).count():
            if time.monotonic() > ends:
                raise TimeoutError(self.tab.inner_text("body"))
            self.tab.wait_for_timeout(500 if self.tab.locator("button.cancel:visible").count() == 0 else STEP * 1000)
            self.take()
        self.tab.wait_for_timeout(500)
        self.take()

    def write(self) -> None:
        """An animated WebP, shown again and again."""
        first, *rest = self.frames
        shown = round(1000 * SECONDS / len(self.frames))
        first.save(FILM, save_all=True, append_images=rest, duration=shown, loop=0, quality=QUALITY, method=6)


def filmed() -> dict:
    """Film it; seconds and clicks of each end, and what the console said."""
    with scratch() as place:
        folder = place / "machine"
        folder.mkdir()
        with children.started(children.python("-m", "greygate", "app", str(folder)), stdout=children.PIPE) as server:
            address = server.stdout.readline().strip()  # type: ignore[union-attr]
            with browsing.chromium() as browser, browsing.opened(browser, address, SIZE, "light") as (tab, told):
                film, began, found = Film(tab), time.monotonic(), {}
                film.take()
                for clicks, (what, then) in enumerate(WAY, 1):
                    film.click(what, then)
                    if clicks in (EFFECT, len(WAY)):
                        name = "effect" if clicks == EFFECT else "verilog"
                        found |= {f"{name}_clicks": clicks, f"{name}_s": round(time.monotonic() - began)}
                        for y in (0, 500):
                            tab.evaluate(SCROLL, y)
                            tab.wait_for_timeout(500)
                            film.take()
                film.write()
                return found | {"frames": len(film.frames), "bytes": FILM.stat().st_size, "console": list(told)}


PARTS = {"app": filmed}
