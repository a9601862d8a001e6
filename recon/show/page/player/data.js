// The data of the clip, with arrays over frames that are unpacked once. Nothing here draws or listens.

const ARRAYS = { i2: [Int16Array, -32768], u1: [Uint8Array, 255], i4: [Int32Array, null] };

/** Return a packed array as numbers, with NaN for unknown values. */
export function unpacked(packed) {
  const text = atob(packed.data), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const [Kind, nothing] = ARRAYS[packed.type];
  const units = new Kind(bytes.buffer); // little-endian, like every machine with a browser
  if (packed.type === "i4") return units;
  const whole = packed.unit === 1 && packed.offset === 0;
  const values = new Float32Array(units.length);
  for (let i = 0; i < units.length; i++) {
    values[i] = units[i] === nothing && !whole ? NaN : packed.offset + packed.unit * units[i];
  }
  return values;
}

/** States of a detection. */
export const MISSING = 0, FITS = 1, OUTLIER = 2;

/** One camera's detections and reprojections; `known` is false if the page does not contain them. */
class CameraPicture {
  constructor(raw, joints) {
    this.name = raw.name;
    this.size = raw.size_px;
    this.joints = joints;
    this.known = raw.detected_px !== null;
    this.notes = raw.notes || []; // by keypoint: problems of its detections, and how the fit treated them
    if (!this.known) return;
    this.detected = unpacked(raw.detected_px);
    this.reprojected = unpacked(raw.reprojected_px);
    this.state = unpacked(raw.state);
    this.likelihood = unpacked(raw.likelihood);
    this.weight = unpacked(raw.weight);
  }

  /** Return the point of an array of pairs, or null. */
  point(values, row, joint) {
    const i = 2 * (row * this.joints + joint);
    return Number.isNaN(values[i]) || Number.isNaN(values[i + 1]) ? null : [values[i], values[i + 1]];
  }

  /** Return the distance in px between a detection and the pose, or NaN. */
  error(row, joint) {
    const i = 2 * (row * this.joints + joint);
    return Math.hypot(this.detected[i] - this.reprojected[i], this.detected[i + 1] - this.reprojected[i + 1]);
  }

  stateOf(row, joint) {
    return this.state[row * this.joints + joint];
  }

  /** Return the median error of a frame in px, or NaN. */
  medianError(row) {
    const errors = [];
    for (let j = 0; j < this.joints; j++) {
      const error = this.error(row, j);
      if (!Number.isNaN(error)) errors.push(error);
    }
    return median(errors);
  }

  /** Return the box around all reprojections of the clip, or the whole picture. */
  box() {
    let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
    for (let i = 0; i < this.reprojected.length; i += 2) {
      const x = this.reprojected[i], y = this.reprojected[i + 1];
      if (Number.isNaN(x) || Number.isNaN(y) || x < 0 || y < 0 || x > this.size[0] || y > this.size[1]) continue;
      left = Math.min(left, x); right = Math.max(right, x);
      top = Math.min(top, y); bottom = Math.max(bottom, y);
    }
    if (left > right) return [0, 0, ...this.size];
    const room = 0.12 * Math.max(right - left, bottom - top, 20);
    return [left - room, top - room, right - left + 2 * room, bottom - top + 2 * room];
  }
}

/** Return the median of some numbers, NaN without any. */
export function median(values) {
  if (!values.length) return NaN;
  const sorted = [...values].sort((a, b) => a - b), middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
}

/** The motion, the cameras, curves, stances, flags and findings of a clip. */
export class Clip {
  constructor(raw) {
    this.frames = unpacked(raw.frames);
    this.count = this.frames.length;
    this.fps = raw.fps;
    this.keypoints = raw.keypoints;
    this.joints = raw.keypoints.length;
    this.limbs = raw.limbs;
    this.reference = raw.reference;
    this.trunk = raw.trunk;
    this.flags = raw.flags; // [first row, row after the last, text]
    this.chosen = raw.chosen;
    this.cameras = raw.cameras.map((camera) => new CameraPicture(camera, this.joints));
    this.curves = raw.curves.map((panel) => ({ ...panel, curves: panel.curves.map((curve) => ({
      ...curve, values: unpacked(curve.values), band: curve.band && unpacked(curve.band) })) }));
    this.feet = raw.feet;
    this.stances = raw.stances;
    this.findings = raw.findings;
    this.pictures = raw.pictures;
    const scene = raw.scene;
    this.xyz = unpacked(scene.joints_m);
    this.spread = unpacked(scene.spread_m);
    this.spreadEvery = scene.spread_every;
    this.radius90 = scene.radius_90;
    this.length = scene.length_m;
    this.ground = scene.ground;
    this.scenery = scene.cameras.map((camera) => ({ ...camera,
      poses: camera.moves ? unpacked(camera.poses) : camera.poses.map((x) => (x === null ? NaN : x)) }));
    this.sides = Array(this.joints).fill("middle");
    for (const limb of this.limbs) {
      if (limb.side !== "middle") for (const joint of limb.joints) this.sides[joint] = limb.side;
    }
  }

  time(row) {
    return this.frames[row] / this.fps;
  }

  /** Return the row whose frame number is nearest. */
  rowOfFrame(frame) {
    let low = 0, high = this.count - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.frames[middle] < frame) low = middle + 1; else high = middle;
    }
    const before = Math.max(0, low - 1);
    return Math.abs(this.frames[before] - frame) <= Math.abs(this.frames[low] - frame) ? before : low;
  }

  hasPose(row) {
    return !Number.isNaN(this.xyz[3 * row * this.joints]);
  }

  joint(row, joint) {
    const i = 3 * (row * this.joints + joint);
    return [this.xyz[i], this.xyz[i + 1], this.xyz[i + 2]];
  }

  /** Return the middle of the pose in a row, or in the nearest row that has a pose. */
  middle(row) {
    for (let away = 0; away < this.count; away++) {
      for (const at of [row - away, row + away]) {
        if (at < 0 || at >= this.count || !this.hasPose(at)) continue;
        const sum = [0, 0, 0];
        for (let j = 0; j < this.joints; j++) this.joint(at, j).forEach((x, axis) => { sum[axis] += x / this.joints; });
        return sum;
      }
    }
    return [0, 0, 0];
  }

  /** Return the height and slope of the ground plane in a row, or null. */
  groundAt(row) {
    return this.ground.find((plane) => row >= plane.rows[0] && row < plane.rows[1]) || this.ground[0] || null;
  }

  flagsAt(row) {
    const run = this.flags.find(([first, stop]) => row >= first && row < stop);
    return run ? run[2] : "";
  }

  /** Return a camera's axes (right, down, ahead) and centre in a row, or null. */
  cameraPose(number, row) {
    const camera = this.scenery[number];
    const values = camera.moves ? camera.poses.slice(12 * row, 12 * row + 12) : camera.poses;
    if ([...values].some(Number.isNaN)) return null;
    return { right: values.slice(0, 3), down: values.slice(3, 6), ahead: values.slice(6, 9), centre: values.slice(9, 12),
      half: camera.half_angles };
  }
}
