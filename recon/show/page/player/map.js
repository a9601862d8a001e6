// View: every keypoint in every frame, coloured by its error or by its likelihood.

import { MISSING, OUTLIER } from "./data.js";
import { Strip } from "./strips.js";

const ROW = 15; // CSS pixels of a keypoint
/** Stops of a colour scale for colour-blind readers, from small to large (viridis without its palest end). */
const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

/** Return the colour of a fraction from 0 to 1. */
function shade(share) {
  const at = Math.min(0.9999, Math.max(0, share)) * (STOPS.length - 1), i = Math.floor(at);
  return STOPS[i].map((low, k) => Math.round(low + (at - i) * (STOPS[i + 1][k] - low)));
}

export class KeypointMap extends Strip {
  constructor(canvas, clip, cursor, output, scale) {
    super(canvas, clip, cursor, output);
    this.of = "error";
    this.scale = scale; // element that explains the colours
    canvas.style.height = `${ROW * clip.joints + 4}px`;
    canvas.addEventListener("pointermove", (event) => {
      const box = canvas.getBoundingClientRect(), joint = Math.floor((event.clientY - box.top - 2) / ROW);
      cursor.hover(joint >= 0 && joint < clip.joints ? joint : -1);
    });
    canvas.addEventListener("pointerleave", () => cursor.hover(-1));
  }

  get gutter() {
    if (!this.longest) this.longest = Math.max(...this.clip.keypoints.map((name) => name.length));
    return Math.min(this.width * 0.34, 18 + 6.4 * this.longest);
  }

  setQuantity(name) {
    this.of = name;
    this.refresh();
  }

  /** Return the error at which the scale ends, the 98th percentile, so that outliers do not hide the rest. */
  limits(camera) {
    if (this.limitsOf && this.limitsOf.camera === camera) return this.limitsOf.ends;
    const errors = [];
    for (let row = 0; row < this.clip.count; row++) {
      for (let j = 0; j < this.clip.joints; j++) { const error = camera.error(row, j); if (error >= 0) errors.push(error); }
    }
    errors.sort((a, b) => a - b);
    const high = errors.length ? errors[Math.floor(0.98 * (errors.length - 1))] : 1;
    this.limitsOf = { camera, ends: [Math.max(0.2, high / 100), Math.max(1, high)] };
    return this.limitsOf.ends;
  }

  drawFlagged() {}

  drawStill(pen, wide, high, paint) {
    const { clip, cursor } = this, camera = clip.cameras[cursor.camera];
    const right = wide - 10, width = Math.max(1, Math.round((right - this.gutter) * (this.canvas.width / wide)));
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    clip.keypoints.forEach((name, j) => {
      pen.fillStyle = paint.ink;
      let text = name;
      while (text.length > 3 && pen.measureText(text).width > this.gutter - 10) text = `${text.slice(0, -2)}…`;
      pen.fillText(text, this.gutter - 6, 2 + ROW * (j + 0.5));
    });
    if (!camera.known) return;
    const [low, top] = this.limits(camera), cells = document.createElement("canvas");
    [cells.width, cells.height] = [width, clip.joints];
    const layer = cells.getContext("2d"), image = layer.createImageData(width, clip.joints);
    const missing = paint.card.match(/\w\w/g).map((two) => parseInt(two, 16));
    for (let x = 0; x < width; x++) {
      // If several frames share a pixel, the worst one is shown.
      const first = this.rowAt(this.gutter + (x / width) * (right - this.gutter));
      const stop = Math.max(first + 1, this.rowAt(this.gutter + ((x + 1) / width) * (right - this.gutter)));
      for (let j = 0; j < clip.joints; j++) {
        let worst = NaN, outlier = false;
        for (let row = first; row < Math.min(stop, clip.count); row++) {
          if (camera.stateOf(row, j) === MISSING) continue;
          const value = this.of === "error" ? camera.error(row, j) : camera.likelihood[row * clip.joints + j];
          if (Number.isNaN(value)) continue;
          worst = Number.isNaN(worst) ? value : this.of === "error" ? Math.max(worst, value) : Math.min(worst, value);
          outlier = outlier || camera.stateOf(row, j) === OUTLIER;
        }
        const share = this.of === "error" ? Math.log(Math.max(worst, low) / low) / Math.log(top / low) : 1 - worst;
        const colour = Number.isNaN(worst) ? missing : outlier && this.of === "error" ? [214, 39, 40] : shade(share);
        image.data.set([...colour, 255], 4 * (j * width + x));
      }
    }
    layer.putImageData(image, 0, 0);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(cells, this.gutter, 2, right - this.gutter, ROW * clip.joints);
    pen.fillStyle = paint.paper;
    for (let j = 1; j < clip.joints; j++) pen.fillRect(this.gutter, 2 + ROW * j - 0.5, right - this.gutter, 1);
    this.tellScale(low, top);
  }

  tellScale(low, top) {
    const bar = STOPS.map((colour) => `rgb(${colour})`), ends = this.of === "error"
      ? [`${low.toFixed(1)} px`, `${top.toFixed(0)} px or more`] : ["likelihood 1", "0"];
    const swatch = (background, wide) => {
      const element = document.createElement("i");
      Object.assign(element.style, { background, width: wide });
      return element;
    };
    this.scale.replaceChildren(ends[0], swatch(`linear-gradient(90deg, ${bar})`, "6rem"), ends[1]);
    if (this.of === "error") this.scale.append(swatch("#d62728", "1rem"), "outlier");
    this.scale.append(swatch("var(--card)", "1rem"), "no detection used");
  }

  clicked(x, y, down) {
    const joint = Math.floor((y - 2) / ROW);
    if (down && joint >= 0 && joint < this.clip.joints) this.cursor.name([joint]);
    if (x >= this.gutter) this.cursor.go(this.rowAt(x));
  }

  value(row) {
    const { clip, cursor } = this, camera = clip.cameras[cursor.camera];
    const joint = cursor.hovered >= 0 ? cursor.hovered : cursor.named.length ? cursor.named[0] : -1;
    if (joint < 0 || !camera.known) return "";
    const error = camera.error(row, joint), likelihood = camera.likelihood[row * clip.joints + joint];
    const how = camera.stateOf(row, joint) === MISSING ? "no detection used"
      : `${Number.isNaN(error) ? "no pose" : `${error.toFixed(1)} px from the pose`}${
        Number.isNaN(likelihood) ? "" : `, likelihood ${likelihood.toFixed(2)}`}`;
    return `${clip.keypoints[joint]}, frame ${clip.frames[row]}: ${how}`;
  }
}
