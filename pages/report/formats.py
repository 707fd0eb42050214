"""The section that compares the range of each format with that of its signal."""

from collections.abc import Sequence

from greygate.pages import figures


def context(study: dict) -> dict:
    """The pictures of every input and operation, and of the weights; and the notes of the compiler on some signals."""
    signals = [s for s in study["signals"] if s["kind"] != "state"]
    return {
        "ranged_on": study["ranged_on"],
        "picture": figures.formats(signals),
        "noted": noted(study["signals"]),
        "weights": study["weights"],
        "weights_picture": figures.formats(study["weights"], of="|weight|"),
    }


def noted(signals: Sequence[dict]) -> list[tuple[str, str]]:
    """(signals and format, note), equal notes together."""
    found: dict[tuple[str, str], list[str]] = {}
    for s in signals:
        if s["note"]:
            found.setdefault((s["fix"], s["note"]), []).append(s["name"])
    return [(f"{', '.join(names)}, {fix}", note) for (fix, note), names in found.items()]
