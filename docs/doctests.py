"""Examples in docstrings are code on the site, not text: an extension of griffe, named in mkdocs.yml."""

import re

import griffe

EXAMPLE = re.compile(r"(?:^[ ]*>>> .*\n?)(?:^(?!\s*$).*\n?)*", re.M)


class Doctests(griffe.Extension):
    """Fences every example, from its first `>>>` to the next empty line."""

    def on_instance(self, *, obj: griffe.Object, **_) -> None:
        if obj.docstring and ">>> " in obj.docstring.value:
            obj.docstring.value = EXAMPLE.sub(
                lambda found: f"```pycon\n{found[0].rstrip()}\n```\n", obj.docstring.value
            )
