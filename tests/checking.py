"""What greygate prints and writes as JSON, against the published schemas.

With GREYGATE_EXAMPLES=1 in the environment, what the tests make becomes the examples of its schemas, in
greygate/examples.json: `GREYGATE_EXAMPLES=1 python -m pytest tests/test_report.py`.
"""

import json
import os
import re
from functools import cache
from pathlib import Path

import pytest

from greygate.schemas import EXAMPLES, examples, load

POSIX = pytest.mark.skipif(not hasattr(os, "getuid"), reason="of a system with POSIX")
FILES = {
    **{f"{name}.json": name for name in ("program", "manifest", "diagnosis", "board", "augment", "commitment")},
    **{"compile.json": "build", "verify.json": "verified", "resources.json": "resources", "report.json": "report"},
    **{"sealed.json": "sealed-answer", "answer.json": "concealed-answer", "run.json": "concealed-run"},
    "vocabulary.json": "vocabulary",
}
"""Name of a file -> its schema."""
TRAINED = ("train", "identify", "build-snn")  # of NAME.json beside NAME.toml


MADE: dict[str, list] = {}  # in this run: name -> examples, each with other fields


def valid(name, content):
    """Check a result, and keep it as an example if that is asked for."""
    validator(name).validate(content)
    fresh = all(isinstance(content, dict) and content.keys() != e.keys() for e in MADE.get(name, ()))
    if fresh and name in examples() and os.environ.get("GREYGATE_EXAMPLES"):
        MADE.setdefault(name, []).append(short(content))
        made = {**examples(), **MADE}
        EXAMPLES.write_text(lines({n: made[n] for n in examples()}), encoding="utf-8")


def short(value):
    """A value whose lists have at most two entries, without folders of this computer."""
    if isinstance(value, dict):
        return {key: short(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [short(inner) for inner in value[:2]]
    return re.sub(r"/\S*/pytest-\d+/[^/\s]+/", "", value) if isinstance(value, str) else value


def lines(found):
    """JSON of lists or tables by name, an entry a line."""
    blocks = []
    for name, entries in found.items():
        named = isinstance(entries, dict)
        rows = [f"{json.dumps(e)}: " * named + json.dumps(entries[e] if named else e) for e in entries]
        blocks.append(f"{json.dumps(name)}: {'[{'[named]}\n" + ",\n".join(rows) + f"\n{']}'[named]}")
    return "{\n" + ",\n".join(blocks) + "\n}\n"


@cache
def validator(name):
    import jsonschema

    return jsonschema.Draft202012Validator(load(name))


def valid_files(folder: Path) -> dict[str, str]:
    """Checks every JSON file that greygate wrote in a folder; name -> schema of those that have one."""
    found = {}
    for path in folder.rglob("*.json"):
        content = json.loads(path.read_text(encoding="utf-8"))
        if path.with_suffix(".toml").exists():
            found[path.name] = next((name for name in TRAINED if validator(name).is_valid(content)), "")
            assert found[path.name], f"{path}: is of none of {TRAINED}"
        elif name := FILES.get(path.name):
            valid(name, content)
            found[path.name] = name
    return found
