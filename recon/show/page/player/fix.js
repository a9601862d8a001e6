// The editor of recon fix: correct detections in the camera's picture. The server saves every change and fits again.

import { Cursor } from "./cursor.js";
import { Clip } from "./data.js";
import { PictureView } from "./picture.js";
import { ON_PICTURE, label } from "./theme.js";

const GRAB_PX = 14, ON_MARK_PX = 6;

/** All corrections by detection, and the data to undo the latest correction. */
class Corrections {
  constructor(rows) {
    this.rows = new Map(rows.map((row) => [Corrections.key(row), row]));
    this.past = [];
  }

  static key({ frame, camera, keypoint }) {
    return JSON.stringify([frame, camera, keypoint]);
  }

  get(cell) {
    return this.rows.get(Corrections.key(cell));
  }

  /** Change several detections in one step, which sets the corrections in rows and removes those of given cells. */
  change(rows, removed = []) {
    const keys = [...rows, ...removed].map(Corrections.key);
    this.past.push(keys.map((key) => [key, this.rows.get(key)]));
    for (const key of keys) this.rows.delete(key);
    for (const row of rows) this.rows.set(Corrections.key(row), row);
  }

  undo() {
    for (const [key, row] of this.past.pop() || []) if (row) this.rows.set(key, row); else this.rows.delete(key);
  }

  get all() {
    return [...this.rows.values()];
  }
}

/** The camera's picture, in which points can be moved. */
class EditedPicture extends PictureView {
  constructor(canvas, clip, cursor, editor) {
    super(canvas, clip, cursor);
    this.editor = editor;
    this.grabbed = -1;
    canvas.addEventListener("pointerdown", (event) => { this.grabbed = this.markAt(...this.at(event)); this.start = null; }, true);
    canvas.addEventListener("pointerup", (event) => this.drop(...this.at(event), event.shiftKey), true);
  }

  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  reset() {} // a double click is two clicks here

  showAll() {
    super.reset();
  }

  /** Return the keypoint whose mark is at a point of the canvas, or -1. Expected positions are no marks. */
  markAt(x, y, reach = GRAB_PX) {
    let best = -1, least = reach;
    for (let j = 0; j < this.clip.joints; j++) {
      const point = this.editor.pointOf(j);
      if (!point) continue;
      const [px, py] = this.place(point), away = Math.hypot(px - x, py - y);
      if (away < least) [best, least] = [j, away];
    }
    return best;
  }

  move(dx, dy) {
    if (this.grabbed < 0) { super.move(dx, dy); return; }
    this.start = this.start || this.editor.pointOf(this.grabbed);
    this.start = [this.start[0] + dx / this.scale, this.start[1] + dy / this.scale];
    this.draw();
  }

  /** End a gesture: move the grabbed point, choose the clicked keypoint, or place the chosen one (always, with Shift). */
  drop(x, y, places) {
    const { editor, grabbed, start, pressed } = this;
    [this.grabbed, this.start, this.pressed] = [-1, null, null];
    if (start) { editor.put(grabbed, start, "moved by hand"); return; }
    if (!pressed || Math.hypot(x - pressed[0], y - pressed[1]) >= 4) return;
    const mark = places ? -1 : this.markAt(x, y, ON_MARK_PX);
    if (mark >= 0 && mark !== editor.keypoint) { editor.choose(mark); return; }
    const { scale, left, top } = this.fit(this.canvas.clientWidth, this.canvas.clientHeight);
    editor.put(editor.keypoint, [left + x / scale, top + y / scale], "placed by hand");
  }

  draw() {
    super.draw();
    if (this.editor) this.drawCorrections();
  }

  drawCorrections() {
    const { canvas, clip, editor, place } = this, pen = canvas.getContext("2d");
    const expected = editor.expected(editor.keypoint);
    this.drawLines();
    if (expected) {
      const [x, y] = place(expected), item = editor.itemOf(editor.keypoint);
      pen.strokeStyle = ON_PICTURE.doubt;
      pen.setLineDash([5, 4]);
      pen.lineWidth = 2;
      pen.beginPath();
      if (item) {
        const [major, minor, angle] = item.ellipse_px;
        pen.ellipse(x, y, Math.max(4, 2 * major * this.scale), Math.max(4, 2 * minor * this.scale), (angle * Math.PI) / 180, 0, 2 * Math.PI);
      } else pen.arc(x, y, 10, 0, 2 * Math.PI);
      pen.stroke();
      pen.setLineDash([]);
    }
    for (let j = 0; j < clip.joints; j++) {
      const row = editor.corrections.get(editor.cell(j)), moving = this.grabbed === j && this.start;
      const point = moving ? this.start : row ? row.now_px || row.was_px : null;
      if (!point) continue;
      const [x, y] = place(point), away = row && !row.now_px && !moving;
      pen.strokeStyle = away ? ON_PICTURE.outlier : ON_PICTURE.doubt;
      pen.lineWidth = 2.5;
      pen.strokeRect(x - 6, y - 6, 12, 12);
      if (away) { pen.beginPath(); pen.moveTo(x - 6, y + 6); pen.lineTo(x + 6, y - 6); pen.stroke(); }
    }
    const at = editor.pointOf(editor.keypoint) || expected;
    if (at && this.cursor.hovered !== editor.keypoint) label(pen, clip.keypoints[editor.keypoint], place(at)[0] + 14, Math.max(12, place(at)[1] - 14), canvas.clientWidth, ON_PICTURE.doubt);
  }

  /** Draw the lines on which other cameras see the chosen keypoint. */
  drawLines() {
    const { canvas, editor, place } = this, pen = canvas.getContext("2d");
    pen.strokeStyle = ON_PICTURE.doubt;
    pen.lineWidth = 1;
    for (const points of Object.values(editor.linesOf(editor.keypoint))) {
      pen.beginPath();
      points.forEach((point, i) => { const [x, y] = place(point); if (i) pen.lineTo(x, y); else pen.moveTo(x, y); });
      pen.stroke();
    }
  }

  /** Show the server's picture of the frame. */
  image(number) {
    const row = this.pictures.rows[number];
    let image = this.images.get(row);
    if (!image) {
      image = new Image();
      image.onload = () => this.draw();
      image.onerror = () => setTimeout(() => { this.images.delete(row); this.draw(); }, 500); // not decoded yet
      image.src = `picture/${row}`;
      this.images.set(row, image);
      if (this.images.size > 120) this.images.delete(this.images.keys().next().value);
    }
    return image;
  }
}

class Editor {
  constructor(root, state) {
    this.root = root;
    this.queue = state.queue;
    this.take(state);
    this.corrections = new Corrections(state.corrections);
    this.cursor = new Cursor(this.clip);
    this.keypoint = 0;
    this.position = -1; // in the queue
    this.lines = { cell: "", shown: {} }; // on which other cameras see the keypoint
    this.begin = null;
    this.picture = new EditedPicture(root.querySelector("canvas"), this.clip, this.cursor, this);
    this.picture.canvas.addEventListener("pointerdown", (event) => { this.picture.pressed = this.picture.at(event); });
    this.picture.chooseFollow();
    this.controls();
    this.cursor.on("row", () => this.draw());
    this.cursor.on("state", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(root);
    this.list();
    this.tell(state);
    this.go(0);
    this.listen(state.version);
  }

  /** Show a fit that the server sent. */
  take(state) {
    this.clip = new Clip({ ...state.clip, pictures: state.video ? this.pictures(state.clip) : null });
    Object.assign(this, { version: state.version, later: state.later_frames, pairs: state.pairs, video: state.video });
  }

  /** Return the description of the server's pictures, one for each row, at full size. */
  pictures(clip) {
    const count = new Clip({ ...clip, pictures: null }).count, size = clip.cameras[clip.chosen].size_px;
    return { rows: [...Array(count).keys()], corners_px: Array(count).fill([0, 0]), size_px: size, first_frame: 0 };
  }

  get camera() {
    return this.clip.cameras[this.cursor.camera];
  }

  cell(joint, row = this.cursor.row) {
    return { frame: this.clip.frames[row] - this.later[this.cursor.camera], camera: this.camera.name, keypoint: this.clip.keypoints[joint] };
  }

  detected(joint, row = this.cursor.row) {
    const item = this.queue.find((x) => Corrections.key(x) === Corrections.key(this.cell(joint, row)));
    if (item && item.found_px) return item.found_px; // also for a detection that was left out
    return this.camera.known ? this.camera.point(this.camera.detected, row, joint) : null;
  }

  /** Return the corrected or the detected position of a keypoint, or null. */
  pointOf(joint, row = this.cursor.row) {
    const correction = this.corrections.get(this.cell(joint, row));
    return correction ? correction.now_px : this.detected(joint, row);
  }

  expected(joint) {
    return this.camera.known ? this.camera.point(this.camera.reprojected, this.cursor.row, joint) : null;
  }

  itemOf(joint) {
    return this.queue.find((item) => Corrections.key(item) === Corrections.key(this.cell(joint)));
  }

  correction(joint, point, reason, row = this.cursor.row) {
    const before = this.corrections.get(this.cell(joint, row)), was = before ? before.was_px : this.detected(joint, row);
    return { ...this.cell(joint, row), was_px: was, now_px: point && point.map((x) => Math.round(100 * x) / 100), reason };
  }

  put(joint, point, reason) {
    this.choose(joint);
    this.change([this.correction(joint, point, reason)]);
  }

  /** Exchange left and right from the frame in which swaps begin to this frame. */
  swap() {
    const from = this.begin === null ? this.cursor.row : this.begin, rows = [];
    for (let row = Math.min(from, this.cursor.row); row <= Math.max(from, this.cursor.row); row++) {
      for (const [left, right] of this.pairs) {
        const points = [this.pointOf(right, row), this.pointOf(left, row)];
        if (points[0] || points[1]) [left, right].forEach((joint, i) => rows.push(this.correction(joint, points[i], "left and right exchanged", row)));
      }
    }
    this.begin = null;
    if (rows.length) this.change(rows);
  }

  change(rows, removed = []) {
    this.corrections.change(rows, removed);
    this.save();
  }

  choose(joint) {
    this.keypoint = joint;
    this.root.querySelector("[data-choose=keypoint]").value = String(joint);
    this.draw();
  }

  /** Go to an entry of the list. */
  go(position) {
    if (!this.queue.length) return;
    this.position = Math.min(this.queue.length - 1, Math.max(0, position));
    const item = this.queue[this.position];
    const camera = this.clip.cameras.findIndex((x) => x.name === item.camera);
    if (camera !== this.cursor.camera) this.cursor.setCamera(camera);
    this.cursor.go(this.clip.rowOfFrame(item.frame + this.later[camera]));
    this.choose(this.clip.keypoints.indexOf(item.keypoint));
    this.mark();
  }

  controls() {
    const { root, cursor, picture } = this, keypoints = root.querySelector("[data-choose=keypoint]");
    this.clip.keypoints.forEach((name, j) => keypoints.add(new Option(name, String(j))));
    keypoints.addEventListener("change", () => this.choose(Number(keypoints.value)));
    const cameras = root.querySelector("[data-choose=camera]");
    this.clip.cameras.forEach((camera, v) => cameras.add(new Option(camera.name, String(v))));
    cameras.parentElement.hidden = this.clip.cameras.length < 2;
    cameras.addEventListener("change", () => cursor.setCamera(Number(cameras.value)));
    this.slider = root.querySelector("input[type=range]");
    this.slider.max = this.clip.count - 1;
    this.slider.addEventListener("input", () => cursor.go(Number(this.slider.value)));
    const actions = {
      back: () => cursor.step(-1), next: () => cursor.step(1),
      accept: () => { const point = this.expected(this.keypoint); if (point) this.put(this.keypoint, point, "accepted"); },
      hide: () => this.put(this.keypoint, null, "not to be used"),
      clear: () => this.change([], [this.cell(this.keypoint)]),
      swap: () => this.swap(),
      begin: () => { this.begin = cursor.row; this.draw(); },
      undo: () => { this.corrections.undo(); this.save(); },
      closer: () => picture.zoom(1.5), all: () => picture.showAll(),
    };
    for (const button of root.querySelectorAll("[data-do]")) button.addEventListener("click", () => actions[button.dataset.do]());
    const keys = { a: "accept", h: "hide", c: "clear", s: "swap", b: "begin", u: "undo", "+": "closer", 0: "all", ArrowLeft: "back", ArrowRight: "next" };
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT)$/.test(event.target.tagName)) return;
      const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      if (key === "n") this.go(this.position + 1);
      else if (key === "p") this.go(this.position - 1);
      else if (key === "k") this.choose((this.keypoint + 1) % this.clip.joints);
      else if (keys[key]) actions[keys[key]]();
      else return;
      event.preventDefault();
    });
  }

  /** Save all corrections after the save in progress, so that an older save never overwrites a newer one. */
  save() {
    this.draw();
    this.mark();
    this.saving = (this.saving || Promise.resolve()).then(() => this.send());
  }

  async send() {
    const { root } = this, rows = this.corrections.all;
    try {
      const answer = await fetch("corrections", { method: "POST", body: JSON.stringify(rows), headers: { "Content-Type": "application/json" } });
      const content = await answer.json();
      root.querySelector(".problem").textContent = content.problem || "";
      if (answer.ok) root.querySelector(".saved").textContent = `${content.saved} corrected, saved. Fitting ...`;
    } catch {
      root.querySelector(".problem").textContent = "recon fix has ended: changes are no longer saved.";
    }
  }

  /** Wait for fits, one after the other. */
  async listen(version) {
    let latest = version, failed = 0;
    while (failed < 3) {
      try {
        const state = await (await fetch(`state/${latest}`)).json();
        failed = 0;
        if (!state) continue;
        latest = state.version;
        this.take({ ...state, video: this.video });
        this.cursor.clip = this.picture.clip = this.clip;
        this.picture.boxes.clear();
        this.tell(state);
        this.draw();
      } catch {
        failed += 1;
        await new Promise((done) => { setTimeout(done, 500); });
      }
    }
    this.root.querySelector(".problem").textContent = "recon fix has ended: changes are no longer saved.";
  }

  /** Return the lines of a keypoint in this frame; request them from the server if they are missing. */
  linesOf(joint) {
    if (this.clip.cameras.length < 2) return {};
    const cell = `${this.cursor.camera}/${this.cursor.row}/${joint}`, wanted = `${cell} ${this.version}`;
    if (this.lines.cell !== wanted) {
      this.lines = { cell: wanted, shown: {} };
      fetch(`lines/${cell}`).then((answer) => answer.json()).then((shown) => {
        if (this.lines.cell !== wanted) return;
        this.lines.shown = shown;
        this.picture.draw();
      }).catch(() => {}); // the server has ended, as the page says
    }
    return this.lines.shown;
  }

  tell(state) {
    const line = ({ level, expected_mm: mm, median_px: px, outliers }) => [level && `verdict “${level}”`,
      mm === null ? "" : `expected pose error ${mm.toFixed(0)} mm`,
      px === null ? "" : `median keypoint error ${px.toFixed(px < 10 ? 1 : 0)} px`,
      outliers === 1 ? "1 outlier" : `${outliers} outliers`].filter(Boolean).join(", ");
    document.querySelector(".verdict-line").textContent = state.version === 0 ? line(state.now) : `before: ${line(state.before)} · now: ${line(state.now)}${state.is_whole ? "" : " (quick fit; the whole one follows)"}`;
    this.root.querySelector(".problem").textContent = state.problem;
    this.root.querySelector(".saved").textContent = `${this.corrections.all.length} corrected, saved in ${state.file}`;
  }

  list() {
    const list = this.root.querySelector(".queue");
    list.replaceChildren(...this.queue.map((item, i) => {
      const entry = document.createElement("li"), button = document.createElement("button");
      button.type = "button";
      const far = item.distance_px === null ? "" : `, ${item.distance_px.toFixed(0)} px`;
      const camera = this.clip.cameras.length > 1 ? `${item.camera}, ` : "";
      button.textContent = `${camera}frame ${item.frame}, ${item.keypoint}: ${item.reason}${far}`;
      button.addEventListener("click", () => this.go(i));
      entry.append(button);
      return entry;
    }));
  }

  mark() {
    this.root.querySelectorAll(".queue li").forEach((entry, i) => {
      entry.setAttribute("aria-current", String(i === this.position));
      entry.classList.toggle("done", this.corrections.get(this.queue[i]) !== undefined);
      if (i === this.position) entry.scrollIntoView({ block: "nearest" });
    });
  }

  draw() {
    const { clip, cursor } = this;
    cursor.named = [];
    this.picture.draw();
    this.slider.value = String(cursor.row);
    const swaps = this.begin === null ? "" : `, swaps begin at frame ${clip.frames[this.begin]}`;
    this.root.querySelector(".status").textContent = `frame ${clip.frames[cursor.row]}${swaps}`;
  }
}

const root = document.querySelector("main.fix");
root.editor = new Editor(root, JSON.parse(document.getElementById("state").textContent));
