// KaTeX 0.19.1 (MIT), as published on npm; its style sheet names the woff2 fonts alone.
// Draws what the build left as TeX: \( \) within a line, \[ \] on a line of its own.
for (const place of document.querySelectorAll(".arithmatex")) {
  const tex = place.textContent.trim();
  katex.render(tex.slice(2, -2), place, { displayMode: tex.startsWith("\\["), throwOnError: false });
}
