"""Opens a page in Chromium in every size and theme, and says what a reader would find wrong with it."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path

SIZES = {"telephone": (390, 844), "tablet": (820, 1180), "desk": (1440, 900)}
THEMES = ("light", "dark")
PAPER = (794, 1123)  # px of A4
LEGIBLE = {"screen": 8, "print": 6}  # px of the smallest text of a picture
CONTRAST = {"text": 4.5, "curve": 1.5}  # to what is behind it; 4.5 is level AA of WCAG 2 for text
TOUCH = 2  # px by which the boxes of two texts may lap: a box is higher than its letters
SCRIPT = Path(__file__).with_suffix(".js").read_text()
DRAWN = "!document.getElementById('plotly') || document.body.dataset.drawn"
SETTLED = 150  # ms after which a drawing that was told to change has changed


def missing() -> str:
    """What is not here to open a page with; empty if nothing is missing."""
    try:
        import playwright  # noqa: F401
    except ImportError:
        return "playwright (the extra `browser`)"
    return "" if binary() else "chromium"


def binary() -> str | None:
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def chromium() -> Iterator:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=binary(), args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def opened(browser, page: Path | str, size: tuple[int, int], theme: str) -> Iterator:
    """The page in a window of its own, and the list of what its console said and what it asked another host for.

    page: a file, or the address of a page on a server of this machine.
    """
    address = page if isinstance(page, str) else page.absolute().as_uri()
    own = ("file:", "data:", "blob:", "/".join(address.split("/")[:3]))
    context = browser.new_context(viewport=dict(zip(("width", "height"), size, strict=True)), color_scheme=theme)
    told: list[str] = []
    tab = context.new_page()
    tab.on("console", lambda message: told.append(f"console {message.type}: {message.text}"))
    tab.on("pageerror", lambda error: told.append(f"error: {error}"))
    tab.on("request", lambda asked: asked.url.startswith(own) or told.append(asked.url))
    tab.goto(address)
    tab.wait_for_function(DRAWN)
    tab.wait_for_timeout(SETTLED)
    yield tab, told
    context.close()


def faults(browser, page: Path) -> dict[str, list[str]]:
    """What is wrong in each of size x theme and on paper, and by keyboard."""
    found = {}
    for (name, size), theme in product(SIZES.items(), THEMES):
        with opened(browser, page, size, theme) as (tab, told):
            found[f"{name}, {theme}"] = looked(tab, "screen") + told
    for theme in THEMES:
        with opened(browser, page, PAPER, theme) as (tab, told):
            tab.emulate_media(media="print")
            tab.wait_for_function(DRAWN + " === 'print'")
            tab.wait_for_timeout(SETTLED)
            found[f"paper, {theme}"] = looked(tab, "print") + told
    with opened(browser, page, SIZES["telephone"], "light") as (tab, told):
        found["keyboard"] = by_keyboard(tab) + told
    return found


def looked(tab, medium: str) -> list[str]:
    return asked(tab, "faults", {"legible": LEGIBLE[medium], "contrast": CONTRAST, "touch": TOUCH})


def asked(tab, question: str, about: dict | None = None):
    """The answer of a function of browsing.js."""
    return tab.evaluate(f"about => {{ {SCRIPT} return browsing.{question}(about); }}", about)


def by_keyboard(tab) -> list[str]:
    """Tab must reach, and frame, everything that can be used; what is wider than the window must be reached as well."""
    wanted, scrolled = asked(tab, "focusable"), asked(tab, "scrolled")
    reached: dict[int, list] = {}
    for _ in range(wanted + scrolled + 5):
        tab.keyboard.press("Tab")
        at = asked(tab, "focused")
        if at is None or at[0] in reached:
            break
        reached[at[0]] = at
    wrong = [
        f"{n} of {len(reached)} have no frame" for n in [sum(not framed for _, framed, _ in reached.values())] if n
    ]
    if len(reached) < wanted + scrolled:
        wrong.append(f"Tab reaches {len(reached)} of {wanted} controls and {scrolled} parts that scroll")
    return wrong
