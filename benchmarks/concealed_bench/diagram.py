"""The reliability diagram: how often claims of each confidence are right."""

from collections.abc import Sequence
from pathlib import Path

from .score import Score
from .tables import reliability

WIDE, HIGH = 70, 200  # of a bar's place, in the picture's units
LEFT, TOP, BELOW = 50, 20, 70  # margins
GAP, ROW = 8, 18  # between bars; of a line of text
LINES = (0.0, 0.5, 1.0)  # shares with a line


def draw(scores: Sequence[Score], path: Path) -> None:
    """Write the reliability diagram as SVG: the confidence that was claimed across, the share of right claims up."""
    bins = reliability(scores)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {LEFT + WIDE * len(bins) + TOP} {HIGH + BELOW}" '
        'font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
    ]
    for share in LINES:
        y = TOP + HIGH * (1 - share)
        parts.append(f'<path d="M{LEFT} {y}h{WIDE * len(bins)}" stroke="#dddddd"/>')
        parts.append(f'<text x="{LEFT - GAP}" y="{y + GAP / 2}" text-anchor="end" fill="#333333">{share:.0%}</text>')
    for number, entry in enumerate(bins):
        x, said = LEFT + WIDE * number, (entry["from"] + entry["to"]) / 2
        if entry["claims"]:
            tall = HIGH * entry["right"] / entry["claims"]
            parts.append(
                f'<rect x="{x + GAP}" y="{TOP + HIGH - tall:.1f}" width="{WIDE - 2 * GAP}" height="{tall:.1f}" '
                'fill="#4878b0"/>'
            )
            parts.append(
                f'<text x="{x + WIDE / 2}" y="{TOP + HIGH - GAP}" text-anchor="middle" fill="#333333" '
                f'stroke="#ffffff" stroke-width="3" paint-order="stroke">{entry["right"]} of {entry["claims"]}</text>'
            )
        y = TOP + HIGH * (1 - said)
        parts.append(f'<path d="M{x + GAP / 2} {y:.1f}h{WIDE - GAP}" stroke="#e08030" stroke-width="2"/>')
        middle = f'x="{x + WIDE / 2}" text-anchor="middle" fill="#333333"'
        parts.append(f'<text {middle} y="{TOP + HIGH + ROW}">{entry["from"]:g} to {entry["to"]:g}</text>')
    parts.append(
        f'<text x="{LEFT}" y="{TOP + HIGH + 2 * ROW}" fill="#333333">'
        "confidence claimed (orange), share of claims that are right (blue)</text>"
    )
    path.write_text("\n".join([*parts, "</svg>", ""]))
