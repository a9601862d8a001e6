// Colours of the page for canvases, and what all canvases share: their size in pixels, gestures, and strokes.

/** Return the page's present colours, which differ in dark mode and in print. */
export function colours(element) {
  const style = getComputedStyle(element), colour = (name) => style.getPropertyValue(`--${name}`).trim();
  return Object.fromEntries(["paper", "ink", "soft", "line", "grid", "card", "link", "warn", "bad", "left", "right", "middle",
    "strong"].map((name) => [name, colour(name)]));
}

/** Colours of the sides and of marks on a picture of any brightness, drawn with a dark edge. */
export const ON_PICTURE = { left: "#56b4e9", right: "#e69f00", middle: "#2fc495", outlier: "#ff4d3d", ring: "#ffffff",
  shadow: "rgba(0,0,0,.75)", paper: "#12151b", doubt: "#ffc83c" };

/** Size a canvas for the screen, and return its pen, in CSS pixels, with width and height. */
export function penOf(canvas) {
  const ratio = Math.min(3, window.devicePixelRatio || 1), wide = canvas.clientWidth, high = canvas.clientHeight;
  const pixels = [Math.round(wide * ratio), Math.round(high * ratio)];
  if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { pen, wide, high };
}

export const FONT = "12px system-ui, sans-serif";

/** Write a text on a background, so that it is legible on any picture. */
export function label(pen, text, x, y, wide, colour = "#fff") {
  pen.font = FONT;
  pen.textBaseline = "middle";
  const width = pen.measureText(text).width, left = Math.max(4, Math.min(x, wide - width - 8));
  pen.fillStyle = "rgba(0,0,0,.72)";
  pen.fillRect(left - 4, y - 9, width + 8, 18);
  pen.fillStyle = colour;
  pen.fillText(text, left, y);
}

/**
 * Let a canvas be dragged, pinched and zoomed. drag(dx, dy, pans), zoom(factor, x, y), hover(x, y) and leave() are called.
 * The wheel zooms if the canvas has the focus or Ctrl is held. Otherwise it scrolls the page.
 */
export function gestures(canvas, { drag, zoom, hover, leave, tap }) {
  const fingers = new Map();
  let moved = 0, button = 0;
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, at(event));
    [moved, button] = [0, event.button];
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = at(event);
    if (!fingers.has(event.pointerId)) { if (hover) hover(...now); return; }
    const before = fingers.get(event.pointerId);
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = (point) => Math.max(10, Math.hypot(point[0] - other[0], point[1] - other[1]));
      zoom(apart(now) / apart(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      drag((now[0] - before[0]) / 2, (now[1] - before[1]) / 2, true);
    } else {
      moved += Math.hypot(now[0] - before[0], now[1] - before[1]);
      drag(now[0] - before[0], now[1] - before[1], event.shiftKey || button > 0);
    }
    fingers.set(event.pointerId, now);
  });
  const lift = (event) => {
    if (fingers.delete(event.pointerId) && event.type === "pointerup" && moved < 4 && tap) tap(...at(event));
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointerleave", () => { if (leave) leave(); });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== canvas) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 500), ...at(event));
  }, { passive: false });
}
