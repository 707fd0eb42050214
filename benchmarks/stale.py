"""Names stored results whose measured code has changed since. Always exit code 0."""

from collections.abc import Mapping
from datetime import date
from functools import cache

from . import made

TAKES = "seconds"


@cache
def last_of(day: str) -> str | None:
    """The last commit of a day."""
    return made.git("rev-list", "-1", f"--before={day} 23:59:59", "HEAD") or None


def commit(how: Mapping) -> str | None:
    """The commit that a stamp means: its own, or that which stored the file, or the last one of its day."""
    for name in (how.get("commit", "").rstrip("+"), how.get("stored", "")):
        if name and known(name):
            return name
    return last_of(how["date"])


@cache
def known(name: str) -> bool:
    """Whether the commit is in the history of this one."""
    full = made.git("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}")
    return bool(full) and made.git("merge-base", full, "HEAD") == full


def stale() -> list[str]:
    """A line for each stored result: commits to its code since, of its oldest part, and its age in days."""
    found, counts = [], {}
    for path, entry in made.index().items():
        measures, parts = entry["measures"], made.stamps(path, entry)
        for key in {commit(how) for how in parts} - {None}:
            counts[key, *measures] = int(made.git("rev-list", "--count", f"{key}..HEAD", "--", *measures))
        behind = [(counts.get((commit(how), *measures), 0), how["date"]) for how in parts]
        if old := [b for b in behind if b[0]]:
            most, day = max(old)
            days = (date.today() - date.fromisoformat(day)).days
            share = f" ({len(old)} of {len(parts)} parts)" if len(parts) > 1 else ""
            found.append(f"{path}{share}: {most} commits to {', '.join(measures)} since, {days} days")
    return found


def main() -> None:
    if made.git("rev-parse", "--is-shallow-repository") != "false":
        print("results older than the code they measure: not known without the history (a shallow clone)")
        return
    lines = stale()
    print(f"results older than the code they measure: {len(lines)}", *lines, sep="\n  ")
