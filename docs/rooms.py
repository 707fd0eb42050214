"""The rooms of the house and the imports between them, read from the source; their picture in CONTRIBUTING.md."""

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
LAYERS = (  # from the top; what stands on one line imports nothing of another on it
    ("greygate",),  # the roof: the command line, projects
    ("export", "pages"),
    ("hardware",),
    ("machines",),
    ("identify",),
    ("compiler", "control", "mismatch"),
    ("emulator", "plants"),
    ("models",),
    ("rtl", "recordings"),
    ("ground",),
)
GROUND = (  # modules of greygate/ on which all stands
    "caches",
    "children",
    "contents",
    "cores",
    "errors",
    "files",
    "foreign",
    "generated",
    "limits",
    "names",
    "plain",
    "progress",
    "reading",
    "system",
    "version",
)
FOLDERS = ("greygate", *(name for layer in LAYERS[1:-1] for name in layer))


@cache
def modules() -> dict[str, Path]:
    """Import name -> file."""
    found = {}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if not (path.parent / "__init__.py").exists():  # a sample, which is data
                continue
            parts = path.relative_to(ROOT).with_suffix("").parts
            parts = parts if folder == "greygate" else ("greygate", *parts)
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports() -> dict[str, set[str]]:
    """Module -> the modules of the house that it imports anywhere."""
    return {name: set(_imported(name, path)) - {name} for name, path in modules().items()}


def _imported(name: str, path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules())
        elif isinstance(node, ast.ImportFrom):
            source = node.module or ""
            if node.level:
                package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
                source = ".".join([*package[: len(package) - node.level + 1], *filter(None, [source])])
            for alias in node.names:
                found = f"{source}.{alias.name}"
                yield from (m for m in [found if found in modules() else source] if m in modules())


def layer(module: str) -> tuple[int, str]:
    """(how far down, which folder)."""
    part = module.removeprefix("greygate").removeprefix(".").partition(".")[0]
    folder = "ground" if part in GROUND else part if any(part in names for names in LAYERS) else "greygate"
    return next((depth, folder) for depth, names in enumerate(LAYERS) if folder in names)


def room(module: str) -> str:
    """The folder of a module; what the roof and the ground of greygate/ are called."""
    found = layer(module)[1]
    return "roof" if found == "greygate" else found


def arrows() -> Counter[tuple[str, str]]:
    """(room, room below) -> how many imports lead there."""
    found = Counter((room(name), room(target)) for name, targets in imports().items() for target in targets)
    return Counter({pair: count for pair, count in found.items() if pair[0] != pair[1]})


def drawn() -> str:
    """The rooms as a Mermaid picture, the roof above: an arrow for each two of which one imports the other."""
    rooms = ["roof" if name == "greygate" else name for names in LAYERS for name in names]
    found = arrows()
    out = ["```mermaid", "flowchart TD"]
    for above, below in sorted(found, key=lambda pair: [rooms.index(name) for name in pair]):
        if not any((above, between) in found and (between, below) in found for between in rooms):
            out.append(f"  {above} --> {below}")  # what goes by way of another room is not drawn
    return "\n".join([*out, "```"])


if __name__ == "__main__":  # lines of Python by room
    for name, files in sorted(Counter(map(room, modules())).items()):
        paths = [path for module, path in modules().items() if room(module) == name]
        print(f"{name:12}{files:5} files{sum(p.read_text(encoding='utf-8').count(chr(10)) for p in paths):8} lines")
