"""The site's start page, Python reference, notebooks and links, and a check that it fetches nothing.

mkdocs calls the functions `on_...` while `make docs` runs (hooks of mkdocs.yml).
"""

import json
import os
import re
import shutil
import tomllib
from pathlib import Path

import notebooks
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "build" / "reference"  # the package as an import sees it; mkdocstrings reads the sources there
NAMES = "<!-- the public names -->"  # stands in reference.md
FIGURES = {"../benchmarks/results/concealed.svg": "pictures/concealed.svg"}  # pictures that a page takes from elsewhere
FOREIGN = re.compile(r"""(?:src|srcset)=["']?(?:https?:)?//|<link(?![^>]*canonical)[^>]*href=["']?(?:https?:)?//""")


def start_page() -> str:
    """README.md as index.md of the site: its links start in docs/."""
    return (ROOT / "README.md").read_text(encoding="utf-8").replace("](docs/", "](").replace('src="docs/', 'src="')


def public_names() -> str:
    """A section for each name that `greygate` offers, read from where it is defined."""
    import greygate

    sections = []
    for name in getattr(greygate, "__all__", ()):
        value = getattr(greygate, name)
        module, qualified = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
        path = f"{module}.{qualified}" if module and qualified else f"greygate.{name}"
        options = {"heading": f"greygate.{name}", "heading_level": 2, "toc_label": name}
        sections.append(f"::: {path}\n    options: {json.dumps(options)}\n")
    return "\n".join(sections)


def on_startup(command: str, dirty: bool) -> None:
    """Lay out the package by pyproject.toml, since its folders do not lie inside each other in the repository."""
    shutil.rmtree(PACKAGE, ignore_errors=True)
    folders = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-dir"]
    for name, folder in sorted(folders.items()):
        target = PACKAGE / name.replace(".", "/")
        target.mkdir(parents=True)
        for source in (ROOT / folder).iterdir():
            os.symlink(source, target / source.name)


def on_files(files, config):
    files.append(File.generated(config, "index.md", content=start_page()))
    for source, shown in FIGURES.items():
        files.append(File.generated(config, shown, abs_src_path=str(ROOT / "docs" / source)))
    for name in notebooks.TUTORIALS:
        files.append(File.generated(config, f"{name}.ipynb", content=notebooks.text(name)))
    return files


def on_page_markdown(markdown, page, config, files) -> str:
    """The public names, pictures from elsewhere, notebooks, and files of the repository, which are named, not linked.

    README.md is the site's first page.
    """
    markdown = markdown.replace("](../README.md", "](index.md")
    for source, shown in FIGURES.items():
        markdown = markdown.replace(source, shown)
    markdown = re.sub(r"\[[^\]]*\]\(\.\./([^)]+)\)", r"`\1`", markdown)
    if (name := page.file.src_uri.removesuffix(".md")) in notebooks.TUTORIALS:
        title, _, rest = markdown.partition("\n")
        markdown = f"{title}\n\n[Download as a notebook]({name}.ipynb){{ download }}\n{rest}"
    return markdown.replace(NAMES, public_names()) if NAMES in markdown else markdown


def on_post_build(config) -> None:
    """Refuse a site that asks another host for a part of itself."""
    for page in Path(config.site_dir).rglob("*.html"):
        if found := FOREIGN.search(page.read_text(encoding="utf-8")):
            raise PluginError(f"{page.name} asks another host: {found[0]}...")
    for style in Path(config.site_dir).rglob("*.css"):
        if re.search(r"url\([\"']?(https?:)?//", style.read_text(encoding="utf-8")):
            raise PluginError(f"{style.name} asks another host")
