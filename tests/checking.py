"""What greygate prints and writes as JSON, against the published schemas."""

import json
from functools import cache
from pathlib import Path

from greygate.schemas import load

FILES = {
    **{f"{name}.json": name for name in ("program", "manifest", "diagnosis", "board", "augment", "commitment")},
    **{"compile.json": "build", "verify.json": "verified", "resources.json": "resources", "report.json": "report"},
    **{"sealed.json": "sealed-answer", "answer.json": "concealed-answer", "run.json": "concealed-run"},
    "vocabulary.json": "vocabulary",
}
"""Name of a file -> its schema."""
TRAINED = ("train", "identify", "build-snn")  # of NAME.json beside NAME.toml


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
            validator(name).validate(content)
            found[path.name] = name
    return found
