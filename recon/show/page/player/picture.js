// View: the camera's picture with the pose and the detections drawn over it.
// The picture comes from the page's own stills, from a video that the reader opened, or is plain.

import { FITS, OUTLIER, median } from "./data.js";
import { ON_PICTURE, gestures, label, penOf } from "./theme.js";

const READY_AHEAD = 6; // pictures decoded in advance while it plays
const SMALL = 0.35, FILLS = 0.6; // fractions of the canvas: an animal smaller than the first is followed until it fills the second

export class PictureView {
  constructor(canvas, clip, cursor) {
    Object.assign(this, { canvas, clip, cursor, images: new Map(), video: null, marks: true });
    this.follow = false;
    this.window = null; // part of the picture that is shown, in px of the video: [left, top, width, height]
    this.boxes = new Map();
    gestures(canvas, {
      drag: (dx, dy) => this.move(dx, dy),
      zoom: (factor, x, y) => this.zoom(factor, x, y),
      hover: (x, y) => cursor.hover(this.keypointAt(x, y)),
      leave: () => cursor.hover(-1),
      tap: (x, y) => { const joint = this.keypointAt(x, y, 24); cursor.name(joint < 0 ? [] : [joint]); },
    });
    canvas.addEventListener("dblclick", () => this.reset());
  }

  /** Show all of the picture. */
  reset() {
    this.window = null;
    this.setFollow(false);
    this.draw();
  }

  setFollow(on) {
    this.follow = on;
    if (this.followed) this.followed(on); // the checkbox "follow the animal"
  }

  get camera() {
    return this.clip.cameras[this.cursor.camera];
  }

  /** Return the page's pictures, or null for a camera without pictures and for a video that the reader opened. */
  get pictures() {
    return this.cursor.camera === this.clip.chosen && !this.video ? this.clip.pictures : null;
  }

  /** Return the number of the picture of a row, or of the nearest picture, or -1. */
  pictureOf(row) {
    const { rows } = this.pictures;
    let low = 0, high = rows.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (rows[middle] < row) low = middle + 1; else high = middle;
    }
    return low > 0 && row - rows[low - 1] <= Math.abs(rows[low] - row) ? low - 1 : low;
  }

  image(number) {
    let image = this.images.get(number);
    if (!image) {
      image = new Image();
      image.src = `data:${this.clip.pictures.mime};base64,${this.clip.pictures.data[number]}`;
      image.decode().then(() => { if (this.wanted === number) this.draw(); }, () => {});
      this.images.set(number, image);
      if (this.images.size > 120) this.images.delete(this.images.keys().next().value);
    }
    return image;
  }

  /** Show a video that the reader opened instead of the page's pictures. */
  openVideo(file, done) {
    const video = document.createElement("video");
    Object.assign(video, { muted: true, playsInline: true, preload: "auto", src: URL.createObjectURL(file) });
    video.addEventListener("loadeddata", () => { this.video = video; this.seek(); done(null, video); });
    video.addEventListener("seeked", () => { this.seeking = false; this.draw(); if (this.due !== this.cursor.row) this.seek(); });
    video.addEventListener("error", () => done("This browser cannot play that video."));
  }

  seek() {
    if (!this.video || this.seeking) return;
    const first = this.clip.pictures ? this.clip.pictures.first_frame : 0;
    const count = Math.round(this.video.duration * this.clip.fps);
    // A file whose frame rate differs from the clip's is played at its own rate, because frames have to match, not times.
    const rate = this.rate || (count ? count / this.video.duration : this.clip.fps);
    this.due = this.cursor.row;
    this.seeking = true;
    this.video.currentTime = Math.max(0, (this.clip.frames[this.due] - first + 0.5) / rate);
  }

  /** Return the part of the picture to show, in px of the video. */
  wholeWindow() {
    const { pictures, camera } = this;
    if (this.video) return [0, 0, ...camera.size];
    if (pictures) {
      const corner = pictures.corners_px[Math.max(0, this.pictureOf(this.cursor.row))];
      return [...corner, ...pictures.size_px];
    }
    if (!camera.known) return [0, 0, ...camera.size];
    if (!this.boxes.has(camera)) this.boxes.set(camera, camera.box());
    return this.boxes.get(camera);
  }

  /** Return the middle and the sides in px of the box around the pose of a row, or null. */
  poseBox(row) {
    const { camera } = this, box = [Infinity, Infinity, -Infinity, -Infinity];
    if (!camera.known) return null;
    for (let j = 0; j < this.clip.joints; j++) {
      const point = camera.point(camera.reprojected, row, j);
      if (!point) continue;
      for (const axis of [0, 1]) {
        box[axis] = Math.min(box[axis], point[axis]);
        box[2 + axis] = Math.max(box[2 + axis], point[axis]);
      }
    }
    if (box[0] > box[2]) return null;
    return { middle: [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2], sides: [box[2] - box[0], box[3] - box[1]] };
  }

  /** Return the animal's usual length in the picture in px. */
  get animalLength() {
    const lengths = [], step = Math.max(1, Math.floor(this.clip.count / 50));
    for (let row = 0; row < this.clip.count; row += step) {
      const box = this.poseBox(row);
      if (box) lengths.push(Math.hypot(...box.sides));
    }
    return median(lengths) || 100;
  }

  /** Follow the animal from the beginning if it is small in the picture. */
  chooseFollow() {
    this.length = this.animalLength;
    this.follow = this.length < SMALL * this.wholeWindow()[2];
  }

  /** Return the scale and the corner of the part that is shown, with canvas = scale * (px - corner). */
  fit(wide, high) {
    const box = this.follow ? this.poseBox(this.shownRow === undefined ? this.cursor.row : this.shownRow) : null;
    if (box) {
      const zoom = this.window || { zoom: 1, x: 0, y: 0 }, side = this.length / FILLS;
      const scale = Math.min(wide / side, (1.6 * high) / side) * zoom.zoom;
      return { scale, left: box.middle[0] - wide / 2 / scale, top: box.middle[1] - high / 2 / scale };
    }
    const whole = this.wholeWindow(), change = this.window || { zoom: 1, x: 0, y: 0 };
    const scale = Math.min(wide / whole[2], high / whole[3]) * change.zoom;
    const x = whole[0] + whole[2] / 2 + change.x * whole[2], y = whole[1] + whole[3] / 2 + change.y * whole[3];
    return { scale, left: x - wide / 2 / scale, top: y - high / 2 / scale };
  }

  move(dx, dy) {
    if (this.follow) this.setFollow(false);
    const { scale } = this.fit(this.canvas.clientWidth, this.canvas.clientHeight), whole = this.wholeWindow();
    this.window = this.window || { zoom: 1, x: 0, y: 0 };
    this.window.x -= dx / scale / whole[2];
    this.window.y -= dy / scale / whole[3];
    this.draw();
  }

  zoom(factor, x, y) {
    const [wide, high] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const [px, py] = x === undefined ? [wide / 2, high / 2] : [x, y];
    this.window = this.window || { zoom: 1, x: 0, y: 0 };
    const before = this.fit(wide, high);
    this.window.zoom = Math.min(20, Math.max(0.5, this.window.zoom * factor));
    const after = this.fit(wide, high), whole = this.wholeWindow();
    this.window.x += (before.left + px / before.scale - after.left - px / after.scale) / whole[2];
    this.window.y += (before.top + py / before.scale - after.top - py / after.scale) / whole[3];
    this.draw();
  }

  keypointAt(x, y, reach = 12) {
    const { camera, place } = this;
    if (!camera.known || !place) return -1;
    let best = -1, least = reach;
    for (let j = 0; j < this.clip.joints; j++) {
      for (const values of [camera.detected, camera.reprojected]) {
        const point = camera.point(values, this.shownRow, j);
        if (!point) continue;
        const away = Math.hypot(...place(point).map((v, i) => v - [x, y][i]));
        if (away < least) [best, least] = [j, away];
      }
    }
    return best;
  }

  draw() {
    const { canvas, clip, cursor, camera } = this, { pen, wide, high } = penOf(canvas);
    pen.fillStyle = ON_PICTURE.paper;
    pen.fillRect(0, 0, wide, high);
    const number = this.pictures ? this.pictureOf(cursor.row) : -1;
    this.shownRow = number < 0 ? cursor.row : this.pictures.rows[number]; // a pose is drawn on the picture that it belongs to
    const { scale, left, top } = this.fit(wide, high);
    this.scale = scale;
    this.place = (point) => [scale * (point[0] - left), scale * (point[1] - top)];
    let note = "";
    if (this.video) {
      const [x, y] = this.place([0, 0]);
      pen.drawImage(this.video, x, y, scale * camera.size[0], scale * camera.size[1]);
    } else if (this.pictures) {
      const image = number < 0 ? null : this.image(number);
      this.wanted = number;
      if (cursor.playing) for (let i = 1; i <= READY_AHEAD; i++) if (number + i < this.pictures.rows.length) this.image(number + i);
      if (image && image.complete && image.naturalWidth) {
        const [x, y] = this.place(this.pictures.corners_px[number]);
        pen.drawImage(image, x, y, scale * this.pictures.size_px[0], scale * this.pictures.size_px[1]);
      }
      if (this.shownRow !== cursor.row) note = `picture of frame ${clip.frames[this.shownRow]}`;
    } else {
      const [x, y] = this.place([0, 0]);
      pen.strokeStyle = "#5d666f";
      pen.strokeRect(x, y, scale * camera.size[0], scale * camera.size[1]);
    }
    if (camera.known && this.marks) this.drawPose(pen, wide);
    if (!camera.known) label(pen, `This page has no detections of ${camera.name}: recon report --camera-name`, 8, 16, wide);
    const flags = clip.flagsAt(cursor.row);
    if (flags) {
      pen.strokeStyle = ON_PICTURE.doubt;
      pen.lineWidth = 4;
      pen.strokeRect(2, 2, wide - 4, high - 4);
      label(pen, flags, 10, 18, wide, ON_PICTURE.doubt);
    }
    if (note) label(pen, note, 10, high - 14, wide);
  }

  drawPose(pen, wide) {
    const { clip, camera, cursor, place } = this, row = this.shownRow;
    const unit = Math.min(1.2, Math.max(0.55, (this.length * this.scale) / 260)); // marks do not hide a small animal
    pen.lineCap = pen.lineJoin = "round";
    for (const [width, shade] of [[2.4 + 2.6 * unit, true], [2.6 * unit, false]]) {
      for (const limb of clip.limbs) {
        pen.beginPath();
        let on = false;
        for (const joint of limb.joints) {
          const point = camera.point(camera.reprojected, row, joint);
          if (point) pen[on ? "lineTo" : "moveTo"](...place(point));
          on = point !== null;
        }
        pen.strokeStyle = shade ? ON_PICTURE.shadow : ON_PICTURE[limb.side];
        pen.lineWidth = width;
        pen.stroke();
      }
    }
    for (let j = 0; j < clip.joints; j++) {
      const found = camera.point(camera.detected, row, j), state = camera.stateOf(row, j);
      if (!found || state < FITS) continue;
      const at = place(found), joint = camera.point(camera.reprojected, row, j);
      const arm = 5 * unit;
      pen.lineWidth = 1.6 * Math.max(unit, 0.7);
      if (state === OUTLIER) {
        pen.strokeStyle = ON_PICTURE.outlier;
        pen.beginPath();
        if (joint) { pen.moveTo(...at); pen.lineTo(...place(joint)); }
        pen.moveTo(at[0] - arm, at[1] - arm); pen.lineTo(at[0] + arm, at[1] + arm);
        pen.moveTo(at[0] - arm, at[1] + arm); pen.lineTo(at[0] + arm, at[1] - arm);
        pen.stroke();
      } else {
        for (const [colour, radius] of [[ON_PICTURE.shadow, 4 * unit + 1], [ON_PICTURE.ring, 4 * unit]]) {
          pen.strokeStyle = colour;
          pen.beginPath();
          pen.arc(...at, radius, 0, 2 * Math.PI);
          pen.stroke();
        }
      }
    }
    const named = cursor.hovered < 0 ? cursor.named : [...new Set([...cursor.named, cursor.hovered])];
    for (const j of named) this.drawName(pen, row, j, wide);
  }

  /** Name a keypoint at its detection, and mark its position in the pose. */
  drawName(pen, row, j, wide) {
    const { clip, camera, place } = this;
    const found = camera.point(camera.detected, row, j), joint = camera.point(camera.reprojected, row, j);
    const at = found || joint, error = camera.error(row, j);
    if (!at) return;
    const [x, y] = place(at);
    pen.strokeStyle = ON_PICTURE.doubt;
    pen.lineWidth = 2.5;
    pen.beginPath();
    pen.arc(x, y, 9, 0, 2 * Math.PI);
    pen.stroke();
    const how = Number.isNaN(error) ? (found ? "no pose" : "not detected") : `${error.toFixed(error < 10 ? 1 : 0)} px from the pose`;
    label(pen, `${clip.keypoints[j]}: ${how}`, x + 14, Math.max(12, y - 12), wide);
    if (camera.notes[j]) label(pen, camera.notes[j], x + 14, Math.max(32, y + 8), wide);
  }
}
