"""Small SVG charts: lines on linear or logarithmic axes, and formats on a scale of powers of two.

Colours are CSS classes of style.html, so that pictures follow the page into dark mode and onto paper.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from markupsafe import Markup

from greygate.pages.units import number

LEFT, RIGHT, TOP, BOTTOM = 58, 10, 8, 34  # margins of a chart, px
ASIDE, DIGIT = 19, 6.5  # px: of the name of an axis that stands on its side, and of a digit of `.tick`
APART = 1e-9  # of a limit: limits of an axis that are nearer to each other are moved apart
BROAD, SHRUNK = 500, 0.8  # a chart that is wider [px] is not shrunk further, as it could not be read, but scrolled
ROW = 19  # height of one signal in `formats`, px
TRUSTED = 0.8  # coherence below which a frequency response is not drawn
CHANGE_DECADES, CHANGE_HEIGHT = 6, 66  # scale and height [px] of a row of `weight_changes`


@dataclass(frozen=True)
class Curve:
    """A line of points: x and y of equal length, None where nothing is drawn; `kind` is the CSS class."""

    x: Sequence[float | None] | np.ndarray
    y: Sequence[float | None] | np.ndarray
    kind: str


@dataclass(frozen=True)
class Scale:
    """Maps [low, high] to [0, length] px."""

    low: float
    high: float
    length: float
    log: bool = False

    def __call__(self, value: float) -> float:
        if self.log:
            at = math.log(value / self.low) / math.log(self.high / self.low) if value > 0 else -1.0
        else:
            at = (value - self.low) / (self.high - self.low)
        return self.length * min(max(at, -3.0), 4.0)

    def ticks(self, spacing: float = 70) -> list[float]:
        """Round values inside the scale, about one every `spacing` px; 1, 2, 5 within the decades of a log scale."""
        if self.log and self.high > 3 * self.low:
            decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            room = self.length / spacing
            span = math.log10(self.high / self.low)
            steps = (1, 2, 5) if 3 * span <= 1.5 * room else (1,)
            every = max(1, math.ceil(span / room))
            found = [s * 10.0**d for d in decades if d % every == 0 for s in steps]
        else:
            rough = (self.high - self.low) * spacing / self.length
            decade = 10.0 ** math.floor(math.log10(rough))
            step = next(s * decade for s in (1, 2, 5, 10) if s * decade >= rough * 0.999)
            found = [
                step * k for k in range(math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9) + 1)
            ]
        slack = 1e-9 * abs(self.high)
        found = [v for v in found if self.low - slack <= v <= self.high + slack]
        return found if len(found) > 1 or spacing < 15 else self.ticks(spacing / 2)


def span(values: Sequence[float | None], log: bool = False, margin: float = 0.06) -> tuple[float, float]:
    """Limits that contain all values with a margin; they are never equal."""
    known = [v for v in values if v is not None and (v > 0 or not log)] or [1.0]
    low, high = min(known), max(known)
    if log:
        room = max((high / low) ** margin, 1.1) if margin else 1.0
        return low / room, high * room
    room = margin * (high - low) if high > low else 0.1 * abs(high) or 1.0
    return low - room, high + room


def _apart(limits: Sequence[float]) -> tuple[float, float]:
    """`limits`, moved apart where they are equal or nothing is drawn."""
    low, high = limits or (0.0, 1.0)
    return (low, high) if high - low > APART * abs(high) else span([low, high])


def chart(
    lines: Sequence[Curve],
    *,
    x: str = "",
    y: str = "",
    x_log: bool = False,
    y_log: bool = False,
    x_limits: tuple[float, float] | None = None,
    y_limits: tuple[float, float] | None = None,
    levels: Sequence[tuple[float, str]] = (),
    marks: Sequence[float] = (),
    x_ticks: Sequence[float] = (),
    inside: str = "",
    left: float = LEFT,
    width: int = 380,
    height: int = 200,
) -> Markup:
    """One plot as inline SVG. x, y: axis labels (no x: no numbers either, for a panel above another).

    levels: horizontal lines (value, label). marks: vertical lines. x_ticks: where numbers stand; round values if empty.
    inside: SVG within the axes, placed in per cent of them. left: px of the margin, more where figures need it.
    """
    bottom = BOTTOM if x else 8
    inner_h = height - TOP - bottom
    every_x = [v for line in lines for v in line.x if v is not None]
    every_y = [v for line in lines for v in line.y] + [v for v, _ in levels]
    sy = Scale(*_apart(y_limits or span(every_y, y_log)), inner_h, y_log)
    y_ticks = sy.ticks(min(34, inner_h / 3))
    y_labels = _labels(y_ticks, y_log)
    left = max(left, ASIDE + DIGIT * max(map(len, y_labels), default=0))
    inner_w = width - left - RIGHT
    sx = Scale(*_apart(x_limits or (every_x and (min(every_x), max(every_x)))), inner_w, x_log)
    parts = [_opened(width, height, f"{y} over {x}")]
    x_ticks = x_ticks or sx.ticks()
    for t, label in zip(y_ticks, y_labels, strict=True):
        at = TOP + inner_h - sy(t)
        parts.append(f'<path class="grid" d="M{left:g} {at:.1f}h{inner_w:g}"/>')
        parts.append(f'<text class="tick" x="{left - 5:g}" y="{at + 3.5:.1f}" text-anchor="end">{label}</text>')
    for t, label in zip(x_ticks, _labels(x_ticks, x_log), strict=True):
        at = left + sx(t)
        parts.append(f'<path class="grid" d="M{at:.1f} {TOP}v{inner_h}"/>')
        if x:
            parts.append(f'<text class="tick" x="{at:.1f}" y="{height - 20}" text-anchor="middle">{label}</text>')
    parts.append(f'<svg x="{left:g}" y="{TOP}" width="{inner_w:g}" height="{inner_h}">{inside}')
    parts += [f'<path class="mark" d="M{sx(m):.1f} 0v{inner_h}"/>' for m in marks]
    parts += [f'<path class="level" d="M0 {inner_h - sy(v):.1f}h{inner_w:g}"/>' for v, _ in levels]
    parts += [f'<path class="line {line.kind}" d="{_path(line, sx, sy, inner_h)}"/>' for line in lines]
    parts.append("</svg>")
    for v, label in levels:
        at = TOP + inner_h - sy(v) - 4
        parts.append(
            f'<text class="tick" x="{width - RIGHT - 3}" y="{at:.1f}" text-anchor="end">{escape(label)}</text>'
        )
    middle = TOP + inner_h / 2
    parts.append(f'<text class="label" transform="translate(11 {middle:.0f}) rotate(-90)">{escape(y)}</text>')
    if x:
        parts.append(f'<text class="label" x="{left + inner_w / 2:.0f}" y="{height - 4}">{escape(x)}</text>')
    return Markup("".join(parts) + "</svg>")


def _opened(width: int, height: int, label: str) -> str:
    least = f' style="min-width:{SHRUNK * width:.0f}px"' if width > BROAD else ""
    return f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(label)}"{least}>'


def accuracy(
    frequency: Sequence[float], found: Mapping[str, Mapping], heights: tuple[int, int, int], width: int = 380
) -> Markup:
    """Magnitude, phase and coherence of Ŷ/Y over frequency [Hz], three panels one above another.

    found: CSS class of a line -> {"magnitude", "phase" [degrees], "coherence"}, as `models.spectra.frequency_response`
    returns them. Magnitude and phase are drawn only where the coherence is at least `TRUSTED`.
    """
    x_limits = span(frequency, log=True, margin=0)

    def panel(part: str, y: str, low: float, high: float, height: int, x: str = "") -> Markup:
        known = part == "coherence"
        lines = [
            Curve(
                frequency,
                [v if known or (c is not None and c >= TRUSTED) else None for v, c in zip(*pair, strict=True)],
                kind,
            )
            for kind, pair in ((kind, (one[part], one["coherence"])) for kind, one in found.items())
        ]
        seen = [v for line in lines for v in line.y if v is not None]
        y_limits = span([*np.percentile(seen, (2, 98)), low, high]) if seen else (low, high)
        levels = [] if known else [((low + high) / 2, "")]
        return chart(
            lines, x=x, y=y, x_log=True, x_limits=x_limits, y_limits=y_limits, levels=levels, width=width, height=height
        )

    return (
        panel("magnitude", "|Ŷ/Y|", 0.9, 1.1, heights[0])
        + panel("phase", "phase [°]", -10, 10, heights[1])
        + panel("coherence", "coherence", 0, 1, heights[2], "frequency [Hz]")
    )


def _labels(ticks: Sequence[float], log: bool) -> list[str]:
    """Figures of one axis, all with the same number of decimals."""
    if log or not ticks:
        return [f"{t:g}" if 5e-4 < t < 2e4 else number(t, 1).removeprefix("1·") for t in ticks]
    step = ticks[1] - ticks[0] if len(ticks) > 1 else abs(ticks[0]) or 1.0
    if step < 1e-4 or max(map(abs, ticks)) >= 1e6:
        digits = 2 + max(0, math.floor(math.log10(max(map(abs, ticks)) / step)))
        return [number(t if abs(t) > step / 2 else 0.0, digits) for t in ticks]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return [f"{t if abs(t) > step / 2 else 0.0:.{decimals}f}".replace("-", "−") for t in ticks]


def _path(line: Curve, sx: Scale, sy: Scale, height: float) -> str:
    text, pen = [], "M"
    for x, y in zip(line.x, line.y, strict=True):
        if x is None or y is None:
            pen = "M"
            continue
        text.append(f"{pen}{sx(x):.1f} {height - sy(y):.1f}")
        pen = "L"
    return "".join(text)


def formats(signals: Sequence[dict], width: int = 1160, of: str = "|signal|, normalised") -> Markup:
    """Draw the range of every format (from its LSB to full scale) and the values of its signal, on a log2 scale.

    signals: entries of a study's `signals` or `weights`. of: the label. Box: quartiles of |signal|; whiskers: from 5 %
    to the largest value. A diamond is the proved bound; an arrow is a bound beyond the right edge.
    """
    left, right = 180, 120
    inner = width - left - right
    lows = [-s["frac"] for s in signals]
    highs = [s["width"] - 1 - s["frac"] for s in signals]
    low, high = min(lows) - 1, max(highs) + 4
    scale = Scale(low, high, inner)
    height = ROW * len(signals) + 38
    parts = [_opened(width, height, "formats against ranges")]
    for bit in range(math.ceil(low / 4) * 4, high + 1, 4):
        at = left + scale(bit)
        power = "1" if bit == 0 else f'2<tspan dy="-4" font-size="10.2">{str(bit).replace("-", "−")}</tspan>'
        parts.append(f'<path class="{"mark" if bit == 0 else "grid"}" d="M{at:.1f} 0V{height - 34}"/>')
        parts.append(f'<text class="tick" x="{at:.1f}" y="{height - 20}" text-anchor="middle">{power}</text>')
    for row, s in enumerate(signals):
        parts.append(_format_row(s, row * ROW + ROW / 2, left, inner, scale))
    parts.append(f'<text class="label" x="{left + inner / 2}" y="{height - 4}">{of}</text>')
    return Markup("".join(parts) + "</svg>")


def _format_row(s: dict, y: float, left: float, inner: float, scale: Scale) -> str:
    def at(value: float) -> float:
        return left + scale(math.log2(value))

    a, b = left + scale(-s["frac"]), left + scale(s["width"] - 1 - s["frac"])
    observed = f"seen {number(s['observed'][0])} to {number(s['observed'][1])}" if s["observed"] else ""
    sound = f"; proved {number(s['sound'][0])} to {number(s['sound'][1])}" if s["sound"] else ""
    parts = [f"<g><title>{escape(s['name'])}: {s['fix']}; {observed}{sound}</title>"]
    parts.append(f'<text class="name" x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{escape(s["name"])}</text>')
    parts.append(f'<rect class="holds" x="{a:.1f}" y="{y - 7:.1f}" width="{b - a:.1f}" height="14" rx="3"/>')
    if s["quantiles"]:
        p5, p25, p50, p75, top = (at(q) for q in s["quantiles"])
        parts.append(f'<path class="whisker" d="M{p5:.1f} {y:.1f}H{top:.1f}M{top:.1f} {y - 4:.1f}v8"/>')
        box = max(p75 - p25, 3.0)
        parts.append(f'<rect class="box" x="{p75 - box:.1f}" y="{y - 4:.1f}" width="{box:.1f}" height="8" rx="1.5"/>')
        if box > 6:
            parts.append(f'<path class="median" d="M{p50:.1f} {y - 4:.1f}v8"/>')
    if s["sound"] and max(map(abs, s["sound"])) > 0:
        bound = at(max(map(abs, s["sound"])))
        if bound <= left + inner - 4:
            parts.append(f'<path class="sound" d="M{bound:.1f} {y - 4.5:.1f}l4.5 4.5l-4.5 4.5l-4.5 -4.5z"/>')
        else:
            parts.append(f'<path class="sound" d="M{left + inner - 9:.1f} {y - 4.5:.1f}l8 4.5l-8 4.5z"/>')
    events = sum(s["saturations"].values())
    worry = f' <tspan class="worry">{events} sat.</tspan>' if events else ""
    parts.append(f'<text class="name" x="{left + inner + 8}" y="{y + 4:.1f}">{s["fix"]}{worry}</text></g>')
    return "".join(parts)


def weight_changes(changes: Mapping[str, np.ndarray], width: int = 1160) -> Markup:
    """Draw the per cent by which each weight changed: a row for each module, a bar for each weight (thesis 5.14-5.16).

    changes: of `models.adaptation.weight_changes`. The scale is logarithmic. Blue weights rose, orange ones fell; red
    ones, of full height, were zero before. The median and largest change of the module stand at the right. The pointer
    shows the name and the figure of a bar.
    """
    rows: dict[str, dict[str, list[tuple[str, float]]]] = {}  # module -> layer -> (weight, change)
    for name, values in changes.items():
        path, _, port = name.rpartition(".")
        module, _, layer = path.rpartition(".")
        bars = rows.setdefault(module or path, {}).setdefault(layer if module else "", [])
        bars += [(f"{path}.{port}[{', '.join(map(str, i))}]", float(v)) for i, v in np.ndenumerate(values)]
    left, right, pitch = 140, 116, CHANGE_HEIGHT + 34
    largest = max((abs(v) for values in changes.values() for v in values.flat if v and not math.isnan(v)), default=1.0)
    top = math.ceil(math.log10(largest) - 1e-9)
    scale = Scale(10.0 ** (top - CHANGE_DECADES), 10.0**top, CHANGE_HEIGHT, log=True)
    places = max((sum(map(len, layers.values())) + 2 * len(layers) for layers in rows.values()), default=1)
    step = min((width - left - right) / places, 14.0)
    height = pitch * len(rows)
    parts = [_opened(width, height, "changes of weights")]
    for row, (module, layers) in enumerate(rows.items()):
        base, x = row * pitch + CHANGE_HEIGHT + 10, float(left)
        middle = base - CHANGE_HEIGHT / 2
        parts.append(f'<text class="name" x="{left - 48}" y="{middle + 4}" text-anchor="end">{escape(module)}</text>')
        for power in range(top - CHANGE_DECADES, top + 1, 2):
            at, label = base - scale(10.0**power), f"{10.0**power:g}"
            parts.append(f'<path class="grid" d="M{left} {at:.1f}H{width - right}"/>')
            parts.append(f'<text class="tick" x="{left - 4}" y="{at + 3.5:.1f}" text-anchor="end">{label}</text>')
        for layer, bars in layers.items():
            at = x + step * len(bars) / 2
            parts.append(f'<text class="tick" x="{at:.1f}" y="{base + 13}" text-anchor="middle">{escape(layer)}</text>')
            parts += [_change_bar(*bar, x + step * i, base, 0.8 * step, scale) for i, bar in enumerate(bars)]
            x += step * (len(bars) + 2)
        sizes = [abs(v) for bars in layers.values() for _, v in bars if not math.isnan(v)] or [0.0]
        for line, (what, value) in enumerate((("median", float(np.median(sizes))), ("max", max(sizes)))):
            at = middle + 16 * line
            parts.append(f'<text class="name" x="{width - right + 10}" y="{at}">{what} {number(value, 2)} %</text>')
    return Markup("".join(parts) + "</svg>")


def _change_bar(name: str, value: float, x: float, base: float, width: float, scale: Scale) -> str:
    if math.isnan(value):
        kind, tall, says = "worry", scale.length, "was 0"
    else:
        kind, tall = ("box" if value > 0 else "sound"), max(scale(abs(value)), 0.0) if value else 0.0
        says = f"{'+' if value > 0 else ''}{number(value)} %"
    place = f'x="{x:.1f}" y="{base - tall:.1f}" width="{width:.1f}" height="{tall:.1f}"'
    return f'<rect class="{kind}" {place}><title>{escape(name)}: {says}</title></rect>'
