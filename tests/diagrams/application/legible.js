// What a window shows of a page; see Measured in browser.py.
(() => {
  const seen = (element) => element.checkVisibility({ opacityProperty: true, visibilityProperty: true });
  const box = (element) => element.getBoundingClientRect();

  let letters = [1000, ""];
  const cut = [];
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const text = texts.currentNode.textContent.trim(), parent = texts.currentNode.parentElement;
    if (!text || !seen(parent) || ["SCRIPT", "STYLE", "OPTION"].includes(parent.tagName)) continue;
    const range = document.createRange();
    range.selectNodeContents(texts.currentNode);
    const place = range.getBoundingClientRect();
    if (!place.width) continue;
    // Letters of a drawing are scaled with it.
    const matrix = parent.ownerSVGElement && parent.getScreenCTM();
    const size = parseFloat(getComputedStyle(parent).fontSize) * (matrix ? Math.hypot(matrix.a, matrix.b) : 1);
    if (size < letters[0]) letters = [size, text.slice(0, 60)];
    const scrolled = parent.closest(".scroll, .list");
    if (!scrolled && (place.right > innerWidth + 1 || place.left < -1)) cut.push(text.slice(0, 60));
  }

  const pictures = [...document.images].filter(seen);
  const canvases = [...document.querySelectorAll("canvas")].filter(seen).map(box);
  const largest = canvases.sort((a, b) => b.width * b.height - a.width * a.height)[0];
  return {
    wide: document.documentElement.scrollWidth,
    cut,
    letters,
    unloaded: pictures.filter((one) => !one.complete || !one.naturalWidth).map((one) => one.alt),
    shrunk: Math.min(1, ...pictures.map((one) => box(one).width / Number(one.getAttribute("width")))),
    canvas: largest ? [largest.width, largest.height] : [0, 0],
  };
})()
