// Views: strips over time under the pictures. All have one time axis, show the cursor, and move it when clicked.
// The curves are drawn once. The cursor is a line over them, so that scrubbing redraws nothing else.
import { FONT, colours, penOf } from "./theme.js";

const DASHES = { left: [5, 3], right: [], middle: [] };

export class Strip {
  constructor(canvas, clip, cursor, output = null) {
    Object.assign(this, { canvas, clip, cursor, output, line: document.createElement("i"), stale: true, visible: true });
    this.line.className = "cursor-line";
    canvas.after(this.line);
    const scrub = (event) => {
      const box = canvas.getBoundingClientRect();
      this.clicked(event.clientX - box.left, event.clientY - box.top, event.type === "pointerdown");
    };
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); scrub(event); });
    canvas.addEventListener("pointermove", (event) => { if (event.buttons && canvas.hasPointerCapture(event.pointerId)) scrub(event); });
  }

  /** Return the width at the last drawing, because asking the page for it is slow and a curve has thousands of points. */
  get width() {
    return this.wide || this.canvas.clientWidth;
  }

  get gutter() {
    return this.width < 480 ? 40 : 56;
  }

  /** Return the x coordinate on the canvas of a row, which may have a fraction. */
  x(row) {
    const { frames, count } = this.clip, whole = Math.min(count - 1, Math.max(0, Math.floor(row)));
    const frame = frames[whole] + (row - whole), span = Math.max(1, frames[count - 1] - frames[0]);
    return this.gutter + ((frame - frames[0]) / span) * (this.width - this.gutter - 10);
  }

  rowAt(x) {
    const { frames, count } = this.clip, span = Math.max(1, frames[count - 1] - frames[0]);
    const share = (x - this.gutter) / (this.width - this.gutter - 10);
    return this.clip.rowOfFrame(frames[0] + share * span);
  }

  /** Show the frame that was clicked. Some subclasses show the first frame of the bar that was hit. */
  clicked(x) {
    this.cursor.go(this.rowAt(x));
  }

  refresh() {
    this.stale = true;
    this.draw();
  }

  /** Draw the strip if it is on the screen (or `always`, for paper), and write its value. */
  draw(always = false) {
    this.paint(always);
    this.write();
  }

  /** Write the value of the frame that was drawn, after all strips are drawn, because new text forces a new layout. */
  write() {
    const text = this.output && this.drawn ? this.value(this.cursor.row) : "";
    if (!this.output || !this.drawn || text === this.output.textContent) return;
    this.output.textContent = text;
  }

  paint(always = false) {
    const { canvas, line } = this;
    this.drawn = canvas.clientWidth > 0 && (this.visible || always);
    if (!this.drawn) return;
    if (this.stale || this.wide !== canvas.clientWidth) {
      const { pen, wide, high } = penOf(canvas), paint = colours(canvas);
      [this.wide, this.stale] = [wide, false];
      pen.clearRect(0, 0, wide, high);
      pen.save();
      pen.font = FONT;
      this.drawFlagged(pen, high, paint);
      this.drawStill(pen, wide, high, paint);
      pen.restore();
      // Without a top, the line begins below the canvas, wherever a longer text above it moves the canvas later.
      Object.assign(line.style, { marginTop: `${-canvas.offsetHeight}px`, height: `${high}px`, left: `${canvas.offsetLeft - 1}px` });
    }
    line.style.transform = `translateX(${this.x(this.cursor.row)}px)`;
  }

  /** Draw a darker background behind frames that have a flag. */
  drawFlagged(pen, high, paint) {
    pen.fillStyle = paint.card;
    for (const [first, stop] of this.clip.flags) {
      const x = this.x(first - 0.5);
      pen.fillRect(x, 0, Math.max(2, this.x(stop - 0.5) - x), high);
    }
  }

  value() {
    return "";
  }
}

const SIDES = ["left", "right", "middle"];
const FILLED = 0.8; // fraction of a panel above which a band only shows that the value is unknown

/** Return the unit as it follows a number, without a blank before a degree sign. */
const unitOf = ({ unit }) => (unit === "°" ? unit : ` ${unit}`);

/** Return the known values of a panel, their ends, and the range of its axis. */
function rangeOf(panel) {
  const all = [];
  for (const { values } of panel.curves) for (const value of values) if (!Number.isNaN(value)) all.push(value);
  const [low, high] = all.length ? all.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]) : [0, 1];
  const room = Math.max(0.08 * (high - low), panel.unit === "°" ? 1 : 1e-3);
  return { all, low, high, range: [panel.least === 0 ? 0 : low - room, high + room] };
}

/** Return a range that also contains the bands, each end by at most the height of the range further. */
function withBands(panel, [low, top]) {
  let [least, most] = [low, top];
  for (const { values, band } of panel.curves) {
    for (let row = 0; band && row < values.length; row++) {
      if (Number.isNaN(values[row]) || Number.isNaN(band[row])) continue;
      [least, most] = [Math.min(least, values[row] - band[row]), Math.max(most, values[row] + band[row])];
    }
  }
  const room = top - low;
  return [panel.least === 0 ? low : Math.max(least, low - room), Math.min(most, top + room)];
}

/** Return whether the bands of all curves would fill a panel that is as high as the curves. */
export function isFilled(panel) {
  const [low, top] = rangeOf(panel).range;
  return panel.curves.every(({ values, band }) => {
    let [covered, count] = [0, 0];
    for (let row = 0; band && row < values.length; row++) {
      if (Number.isNaN(values[row]) || Number.isNaN(band[row])) continue;
      covered += Math.min(top, values[row] + band[row]) - Math.max(low, values[row] - band[row]);
      count += 1;
    }
    return count > 0 && covered >= FILLED * count * (top - low);
  });
}

/** Numbers over time, one curve for each side, with 90 % bands. */
export class CurveStrip extends Strip {
  constructor(canvas, clip, cursor, output, panel) {
    super(canvas, clip, cursor, output);
    this.setPanel(panel);
  }

  setPanel(panel) {
    this.panel = panel;
    const { all, low, high, range } = rangeOf(panel);
    this.filled = isFilled(panel);
    this.range = this.filled ? range : withBands(panel, range);
    this.text = all.length ? `${panel.title}: ${this.format(low)} to ${this.format(high)}${unitOf(panel)}` : `${panel.title}: not known`;
    this.canvas.setAttribute("aria-label", `${this.text}. A click shows the frame.`);
    this.stale = true;
  }

  format(value) {
    return fixed(value, this.panel.unit === "°" || Math.abs(value) >= 100 ? 0 : Math.abs(value) >= 10 ? 1 : 2);
  }

  get ticks() {
    return ticks(...this.range);
  }

  y(value, high) {
    const [low, top] = this.range;
    return high - 6 - ((value - low) / (top - low)) * (high - 12);
  }

  drawStill(pen, wide, high, paint) {
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (const value of this.ticks) {
      const y = this.y(value, high);
      pen.fillStyle = paint.line;
      pen.fillRect(this.gutter, Math.round(y), wide - this.gutter - 10, 1);
      pen.fillStyle = paint.soft;
      pen.fillText(withMinus(String(+value.toFixed(6))), this.gutter - 6, y);
    }
    if (this.filled) {
      pen.fillStyle = paint.soft;
      pen.textAlign = "left";
      pen.fillText("not known: the 90 % band would fill the panel", this.gutter + 6, 8);
      return;
    }
    for (const curve of this.panel.curves) if (curve.band) this.drawBand(pen, curve, high, paint);
    for (const curve of this.panel.curves) {
      pen.strokeStyle = curve.measured ? paint[curve.side] : paint.soft;
      pen.lineWidth = 1.6;
      pen.setLineDash(DASHES[curve.side]);
      pen.beginPath();
      let on = false;
      for (const [row, value] of this.thinned(curve.values, wide)) {
        if (Number.isNaN(value)) { on = false; continue; }
        pen[on ? "lineTo" : "moveTo"](this.x(row), this.y(value, high));
        on = true;
      }
      pen.stroke();
      pen.setLineDash([]);
    }
  }

  /** Return the points to draw as row and value. In a long clip, these are the least and the greatest in each half pixel. */
  thinned(values, wide) {
    const every = Math.floor(this.clip.count / (2 * wide)), points = [];
    if (every < 2) { values.forEach((value, row) => points.push([row, value])); return points; }
    for (let row = 0; row < values.length; row += every) {
      let [low, high] = [row, row];
      for (let i = row; i < Math.min(row + every, values.length); i++) {
        if (Number.isNaN(values[i])) { low = high = i; break; }
        if (values[i] < values[low]) low = i;
        if (values[i] > values[high]) high = i;
      }
      points.push([Math.min(low, high), values[Math.min(low, high)]]);
      if (low !== high) points.push([Math.max(low, high), values[Math.max(low, high)]]);
    }
    return points;
  }

  drawBand(pen, curve, high, paint) {
    const { values, band } = curve, every = Math.max(1, Math.floor(this.clip.count / this.canvas.clientWidth));
    pen.save();
    pen.globalAlpha = 0.16;
    pen.fillStyle = curve.measured ? paint[curve.side] : paint.soft;
    for (let row = 0; row < this.clip.count;) {
      let stop = row;
      while (stop < this.clip.count && !Number.isNaN(values[stop]) && !Number.isNaN(band[stop])) stop++;
      if (stop > row) {
        pen.beginPath();
        for (let i = row; i < stop; i += every) pen.lineTo(this.x(i), clamp(this.y(values[i] + band[i], high), high));
        for (let i = stop - 1; i >= row; i -= every) pen.lineTo(this.x(i), clamp(this.y(values[i] - band[i], high), high));
        pen.fill();
      }
      row = Math.max(stop, row + 1);
    }
    pen.restore();
  }

  value(row) {
    const texts = SIDES.flatMap((side) => this.panel.curves.filter((curve) => curve.side === side))
      .filter((curve) => !Number.isNaN(curve.values[row]))
      .map(({ side, values, band }) => `${side === "middle" ? "" : `${side} `}${
        withBand(values[row], band ? band[row] : NaN)}${unitOf(this.panel)}`);
    return texts.join(", ") || "not known";
  }
}

/** Return a value with its band, both with as many digits as the band supports. */
export function withBand(value, band) {
  const size = Number.isNaN(band) ? Math.abs(value) / 10 : band, digits = size >= 9.5 ? 0 : size >= 0.95 ? 1 : 2;
  return Number.isNaN(band) ? fixed(value, digits) : `${fixed(value, digits)} ± ${fixed(band, digits)}`;
}

/** Return a number's text with a minus sign instead of a hyphen, as in the figures. */
function withMinus(text) {
  return text.replace("-", "\u2212");
}

/** Return a number with a fixed number of digits, and zero without a sign. */
function fixed(value, digits) {
  return withMinus(value.toFixed(digits).replace(/^-(?=[0.]*$)/, ""));
}

function clamp(y, high) {
  return Math.min(high, Math.max(0, y));
}

/** Return two to five round values within a range, if possible four. */
function ticks(low, high) {
  const power = 10 ** Math.floor(Math.log10(high - low));
  const multiples = [0.1, 0.2, 0.5, 1, 2, 5].map((x) => {
    const step = x * power, first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
    return Array.from({ length: Math.max(0, last - first + 1) }, (_, k) => (first + k) * step);
  });
  return multiples.reduce((best, values) => (Math.abs(values.length - 4) <= Math.abs(best.length - 4) ? values : best));
}

/** The median distance between detections and pose. */
export class ErrorStrip extends CurveStrip {
  constructor(canvas, clip, cursor, output) {
    super(canvas, clip, cursor, output, errorPanel(clip.cameras[cursor.camera], clip));
  }

  cameraChanged() {
    this.setPanel(errorPanel(this.clip.cameras[this.cursor.camera], this.clip));
  }
}

function errorPanel(camera, clip) {
  const values = new Float32Array(clip.count).fill(NaN);
  if (camera.known) for (let row = 0; row < clip.count; row++) values[row] = camera.medianError(row);
  return { title: "median keypoint error", unit: "px", least: 0, curves: [{ side: "middle", values, band: null, measured: true }] };
}

/** Bars of the stances of each foot. A click shows the touch-down. */
export class FootStrip extends Strip {
  y(foot, high) {
    return 4 + (this.clip.feet.indexOf(foot) * (high - 8)) / this.clip.feet.length;
  }

  drawStill(pen, wide, high, paint) {
    const row = (high - 8) / this.clip.feet.length;
    pen.textBaseline = "middle";
    for (const foot of this.clip.feet) {
      pen.textAlign = "right";
      pen.fillStyle = paint.soft;
      pen.fillText(foot, this.gutter - 6, this.y(foot, high) + row / 2);
      pen.fillStyle = paint.line;
      pen.fillRect(this.gutter, Math.round(this.y(foot, high) + row / 2), wide - this.gutter - 10, 1);
    }
    for (const { foot, rows } of this.clip.stances) {
      const x = this.x(rows[0]);
      pen.fillStyle = paint[foot.startsWith("L") ? "left" : foot.startsWith("R") ? "right" : "middle"];
      pen.fillRect(x, this.y(foot, high) + 2, Math.max(2, this.x(rows[1]) - x), row - 4);
    }
  }

  clicked(x, y, down) {
    const row = (this.canvas.clientHeight - 8) / this.clip.feet.length, foot = this.clip.feet[Math.floor((y - 4) / row)];
    const hit = down && this.clip.stances.find((stance) => stance.foot === foot
      && x >= this.x(stance.rows[0]) - 2 && x <= this.x(stance.rows[1]) + 2);
    this.cursor.go(hit ? Math.ceil(hit.rows[0]) : this.rowAt(x));
  }

  value(row) {
    const standing = this.clip.stances.filter(({ rows }) => row >= rows[0] && row <= rows[1]).map(({ foot }) => foot);
    return standing.length ? `${standing.join(", ")} on the ground` : "no foot on the ground";
  }
}

/** Flagged frames, with a row for each flag. A click shows the first frame of a run. */
export class FlagStrip extends Strip {
  constructor(canvas, clip, cursor, output) {
    super(canvas, clip, cursor, output);
    this.kinds = [...new Set(clip.flags.flatMap(([, , text]) => text.split(", ")))];
    canvas.style.height = `${Math.max(1, this.kinds.length) * 18 + 6}px`;
  }

  drawStill(pen, wide, high, paint) {
    pen.textBaseline = "middle";
    this.kinds.forEach((kind, i) => {
      const y = 3 + 18 * i, runs = this.clip.flags.filter(([, , text]) => text.split(", ").includes(kind));
      pen.fillStyle = paint.warn;
      for (const [first, stop] of runs) {
        const x = this.x(first - 0.5);
        pen.fillRect(x, y + 2, Math.max(2, this.x(stop - 0.5) - x), 14);
      }
      // The name stands where no bar covers it, left or right, or within a long bar in the colour of the page.
      const width = pen.measureText(kind).width, left = this.gutter + 6, right = wide - 14 - width;
      const covered = (x) => runs.some(([first, stop]) => this.x(stop) > x - 4 && this.x(first - 0.5) < x + width + 4);
      const x = covered(left) && !covered(right) ? right : left;
      const within = runs.some(([first, stop]) => this.x(first - 0.5) <= x && this.x(stop - 0.5) >= x + width);
      pen.textAlign = "left";
      pen.fillStyle = paint.paper;
      if (!within) {
        pen.fillRect(x - 3, y + 1, width + 6, 16);
        pen.fillStyle = paint.ink;
      }
      pen.fillText(kind, x, y + 9);
    });
  }

  clicked(x, y, down) {
    const row = this.rowAt(x), hit = down && this.clip.flags.find(([first, stop]) => row >= first - 1 && row <= stop);
    this.cursor.go(hit && (row < hit[0] || row >= hit[1]) ? hit[0] : row);
  }

  value(row) {
    return this.clip.flagsAt(row) || "no flag";
  }
}

