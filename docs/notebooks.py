"""The tutorials as notebooks: `python docs/notebooks.py notebooks` writes them; `make docs` puts them on the site.

The page is the source. Its Python and shell blocks become cells, a file that the reader is to write becomes a cell that
writes it, and a page that a command writes is shown below its cell. A link within the site becomes plain text.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

DOCS = Path(__file__).parent
TUTORIALS = sorted(path.stem for path in DOCS.glob("tutorial_*.md"))
RUN = re.compile(r'```(python|sh|\w+ title="([\w/.]+)")\n(.*?)```\n', re.S)
LINK = re.compile(r"\[([^\]]+)\]\((?!http)[^)]+\)")
WRITTEN = re.compile(r"--(?:out|html) (\S+\.html)")
HEIGHT = 600  # of a page below its cell, in pixels


def notebook(name: str) -> nbformat.NotebookNode:
    """The notebook of a tutorial; the same text gives the same notebook."""
    cells = list(_cells((DOCS / f"{name}.md").read_text(encoding="utf-8")))
    for number, cell in enumerate(cells):
        cell.id = f"cell-{number}"
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return new_notebook(cells=cells, metadata={"kernelspec": kernel, "language_info": {"name": "python"}})


def _cells(text: str) -> Iterator[nbformat.NotebookNode]:
    end = 0
    for block in RUN.finditer(text):
        yield from _told(text[end : block.start()])
        kind, path, code = block.groups()
        yield from _file(path, code) if path else _run(kind, code.rstrip())
        end = block.end()
    yield from _told(text[end:])


def _told(text: str) -> Iterator[nbformat.NotebookNode]:
    if text.strip():
        yield new_markdown_cell(LINK.sub(r"\1", text).strip())


def _file(path: str, content: str) -> Iterator[nbformat.NotebookNode]:
    if folder := path.rpartition("/")[0]:
        yield new_code_cell(f"!mkdir -p {folder}")
    yield new_code_cell(f"%%writefile {path}\n{content.rstrip()}")


def _run(kind: str, code: str) -> Iterator[nbformat.NotebookNode]:
    yield new_code_cell(code if kind == "python" else f"%%bash -e\n{code}")
    for page in WRITTEN.findall(code) if kind == "sh" else ():
        yield new_code_cell(f'from IPython.display import IFrame\n\nIFrame("{page}", "100%", {HEIGHT})')


def text(name: str) -> str:
    """The file of a tutorial's notebook."""
    return nbformat.writes(notebook(name)) + "\n"


if __name__ == "__main__":
    for name in TUTORIALS:
        (Path(sys.argv[1]) / f"{name}.ipynb").write_text(text(name), encoding="utf-8", newline="\n")
