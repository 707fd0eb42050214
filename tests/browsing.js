// What tests/browsing.py runs in a page.
const browsing = {
faults: ({legible, contrast, touch}) => {
  const faults = new Set(), ink = document.createElement("canvas").getContext("2d", {willReadFrequently: true});
  const named = e => `${e.tagName.toLowerCase()} ${e.getAttribute("class") || ""} "${e.textContent.trim().slice(0, 40)}"`;
  const rgba = colour => { ink.clearRect(0, 0, 1, 1); ink.fillStyle = colour; ink.fillRect(0, 0, 1, 1); return [...ink.getImageData(0, 0, 1, 1).data]; };
  const behind = e => { for (; e; e = e.parentElement) { const c = rgba(getComputedStyle(e).backgroundColor); if (c[3] > 250) return c; } return [255, 255, 255]; };
  const light = c => c.slice(0, 3).map(v => v / 255).map(v => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4).reduce((sum, v, k) => sum + v * [.2126, .7152, .0722][k], 0);
  const apart = (a, b) => (Math.max(light(a), light(b)) + .05) / (Math.min(light(a), light(b)) + .05);
  const wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  if (wide > 0) faults.add(`the page is ${wide} px wider than the window`);
  for (const e of document.querySelectorAll("body *")) {
    if (!e.checkVisibility() || e.closest("script, style")) continue;
    const style = getComputedStyle(e), drawing = e.closest("svg");
    if ([...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim())) {
      const found = apart(rgba(drawing ? style.fill : style.color), behind(e));
      if (found < contrast.text) faults.add(`contrast ${found.toFixed(1)} of ${named(e)}`);
      const scale = drawing ? e.getScreenCTM() : null, size = scale && parseFloat(style.fontSize) * Math.hypot(scale.a, scale.b);
      if (size && size < legible) faults.add(`${size.toFixed(1)} px is the size of ${named(e)}`);
    }
    if (e.matches("svg path.line:not(.none)") && (e.getAttribute("d") || "").length > 20) {
      const seen = [style.stroke, style.fill].filter(c => c !== "none").map(c => apart(rgba(c), behind(e)));
      if (!(Math.max(...seen) >= contrast.curve)) faults.add(`a curve of class "${e.getAttribute("class")}" cannot be seen`);
    }
  }
  for (const drawing of document.querySelectorAll("svg")) {
    const written = [...drawing.querySelectorAll("text")].filter(e => e.checkVisibility() && e.textContent.trim()).map(e => [e, e.getBoundingClientRect()]);
    const over = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > touch && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > touch;
    for (const [k, [e, a]] of written.entries()) for (const [other, b] of written.slice(k + 1))
      if (over(a, b)) faults.add(`${named(e)} stands over ${named(other)}`);
  }
  return [...faults];
},

scrolled: () => [...document.querySelectorAll("main *")].filter(e => e.checkVisibility() && !e.closest("svg")
  && e.scrollWidth > e.clientWidth + 1 && ["auto", "scroll"].includes(getComputedStyle(e).overflowX)).length,

focusable: () => [...document.querySelectorAll("a[href], button:enabled, input, select, summary, [tabindex='0']")].filter(e => e.checkVisibility() && (e.type !== "radio" || e.checked)).length, // arrows go through a group

focused: () => { const e = document.activeElement; if (!e || e === document.body) return null;
  e.number = e.number || ++window.numbered || (window.numbered = 1);
  return [e.number, e.matches("iframe") || getComputedStyle(e).outlineStyle !== "none", // what is in a frame has its own
    e.scrollWidth > e.clientWidth + 1 && !e.matches("a, summary, .plot")]; },
};
