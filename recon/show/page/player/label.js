// The page of recon label: label frames of a video from scratch. The server saves every change.

import { ON_PICTURE, gestures, label, penOf } from "./theme.js";

const ON_MARK_PX = 10, MOST_ZOOM = 40;

class LabelPage {
  constructor(root, state) {
    Object.assign(this, { root, names: state.names, frames: state.frames, edges: state.edges, size: state.size_px, folder: state.folder });
    this.points = new Map(state.points.map(([frame, joint, x, y]) => [`${frame}/${joint}`, [x, y]]));
    this.skipped = new Set(); // points that are not visible
    Object.assign(this, { past: [], number: 0, joint: 0, grabbed: -1, moved: false, window: { zoom: 1, x: 0, y: 0 }, images: new Map() });
    this.canvas = root.querySelector("canvas");
    this.controls();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    this.go(Math.max(0, this.frames.findIndex((frame) => !this.count(frame))));
    this.told(`${this.points.size} labels, saved in ${this.folder}`);
  }

  get frame() {
    return this.frames[this.number];
  }

  key(joint = this.joint) {
    return `${this.frame}/${joint}`;
  }

  point(joint) {
    return this.points.get(this.key(joint));
  }

  count(frame) {
    return this.names.filter((_, joint) => this.points.has(`${frame}/${joint}`)).length;
  }

  /** Set the position of a label, or remove the label if the position is null. */
  change(joint, point) {
    const key = this.key(joint);
    this.past.push([this.number, joint, this.points.get(key), this.skipped.has(key)]);
    this.points.delete(key);
    this.skipped.delete(key);
    if (point) this.points.set(key, point); else this.skipped.add(key);
    this.save();
  }

  put(joint, [x, y]) {
    const inside = (value, size) => Math.round(100 * Math.min(size - 1, Math.max(0, value))) / 100;
    this.change(joint, [inside(x, this.size[0]), inside(y, this.size[1])]);
  }

  undo() {
    const last = this.past.pop();
    if (!last) return;
    const [number, joint, point, wasSkipped] = last;
    if (number !== this.number) this.go(number);
    const key = this.key(joint);
    if (point) this.points.set(key, point); else this.points.delete(key);
    if (wasSkipped) this.skipped.add(key); else this.skipped.delete(key);
    this.choose(joint);
    this.save();
  }

  /** Choose the next keypoint of the frame that is neither labelled nor skipped. */
  nextJoint() {
    const order = this.names.map((_, i) => (this.joint + 1 + i) % this.names.length);
    const open = order.find((joint) => !this.point(joint) && !this.skipped.has(this.key(joint)));
    if (open !== undefined) this.choose(open);
  }

  /** Save all labels after the save in progress, so that an older save never overwrites a newer one. */
  save() {
    this.draw();
    this.list();
    this.saving = (this.saving || Promise.resolve()).then(() => this.send());
  }

  async send() {
    const rows = [...this.points].map(([key, point]) => [...key.split("/").map(Number), ...point]);
    try {
      const answer = await fetch("labels", { method: "POST", body: JSON.stringify(rows), headers: { "Content-Type": "application/json" } });
      const content = await answer.json();
      this.root.querySelector(".problem").textContent = content.problem || "";
      if (answer.ok) this.told(`${content.saved} labels, saved in ${this.folder}`);
    } catch {
      this.root.querySelector(".problem").textContent = "recon label has ended: changes are no longer saved.";
    }
  }

  told(text) {
    this.root.querySelector(".saved").textContent = text;
  }

  go(number) {
    this.number = Math.min(this.frames.length - 1, Math.max(0, number));
    this.joint = this.names.length - 1;
    this.nextJoint();
    this.list();
    this.draw();
  }

  choose(joint) {
    this.joint = joint;
    this.root.querySelector("[data-choose=keypoint]").value = String(joint);
    this.draw();
  }

  controls() {
    const { root, canvas } = this, keypoints = root.querySelector("[data-choose=keypoint]");
    this.names.forEach((name, joint) => keypoints.add(new Option(name, String(joint))));
    keypoints.addEventListener("change", () => this.choose(Number(keypoints.value)));
    const at = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    canvas.addEventListener("pointerdown", (event) => {
      this.pressed = at(event);
      this.moved = false;
      this.grabbed = event.shiftKey ? -1 : this.markAt(...this.pressed);
    }, true);
    canvas.addEventListener("pointerup", (event) => this.drop(...at(event)), true);
    gestures(canvas, { drag: (dx, dy) => this.drag(dx, dy), zoom: (factor, x, y) => this.zoom(factor, x, y) });
    const actions = {
      back: () => this.go(this.number - 1), next: () => this.go(this.number + 1),
      skip: () => { this.change(this.joint, null); this.nextJoint(); },
      undo: () => this.undo(), closer: () => this.zoom(1.5), all: () => { this.window = { zoom: 1, x: 0, y: 0 }; this.draw(); },
      keypoint: () => this.choose((this.joint + 1) % this.names.length),
    };
    for (const button of root.querySelectorAll("[data-do]")) button.addEventListener("click", () => actions[button.dataset.do]());
    const keys = { n: "next", p: "back", ArrowRight: "next", ArrowLeft: "back", h: "skip", u: "undo", k: "keypoint", "+": "closer", 0: "all" };
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT)$/.test(event.target.tagName)) return;
      const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!action) return;
      actions[action]();
      event.preventDefault();
    });
  }

  /** Return the scale and the corner of the part that is shown. */
  fit() {
    const wide = this.canvas.clientWidth, high = this.canvas.clientHeight, [width, height] = this.size;
    const scale = Math.min(wide / width, high / height) * this.window.zoom;
    return { scale, left: width / 2 + this.window.x - wide / 2 / scale, top: height / 2 + this.window.y - high / 2 / scale };
  }

  /** Return the position on the canvas of a point of the picture. */
  place([x, y]) {
    const { scale, left, top } = this.fit();
    return [scale * (x - left), scale * (y - top)];
  }

  /** Return the point of the picture at a position on the canvas. */
  pointAt(x, y) {
    const { scale, left, top } = this.fit();
    return [left + x / scale, top + y / scale];
  }

  zoom(factor, x = this.canvas.clientWidth / 2, y = this.canvas.clientHeight / 2) {
    const before = this.pointAt(x, y);
    this.window.zoom = Math.min(MOST_ZOOM, Math.max(1, this.window.zoom * factor));
    const after = this.pointAt(x, y);
    this.window.x += before[0] - after[0];
    this.window.y += before[1] - after[1];
    this.draw();
  }

  markAt(x, y) {
    const away = this.names.map((_, joint) => {
      const point = this.point(joint);
      return point ? Math.hypot(...this.place(point).map((v, i) => v - [x, y][i])) : Infinity;
    });
    const least = Math.min(...away);
    return least < ON_MARK_PX ? away.indexOf(least) : -1;
  }

  drag(dx, dy) {
    const { scale } = this.fit();
    if (this.grabbed < 0) { this.window.x -= dx / scale; this.window.y -= dy / scale; } else {
      this.start = this.start || this.point(this.grabbed);
      this.start = [this.start[0] + dx / scale, this.start[1] + dy / scale];
    }
    this.draw();
  }

  /** End a gesture: move the grabbed label, choose the clicked one, or place the chosen keypoint. */
  drop(x, y) {
    const { grabbed, start, pressed } = this;
    [this.grabbed, this.start, this.pressed] = [-1, null, null];
    if (!pressed) return;
    const still = Math.hypot(x - pressed[0], y - pressed[1]) < 4;
    if (grabbed >= 0 && start && !still) { this.put(grabbed, start); this.choose(grabbed); return; }
    if (!still) return;
    if (grabbed >= 0 && grabbed !== this.joint) { this.choose(grabbed); return; }
    this.put(this.joint, this.pointAt(x, y));
    this.nextJoint();
  }

  image() {
    const { frame } = this;
    if (!this.images.has(frame)) {
      const image = new Image();
      image.onload = () => this.draw();
      image.src = `picture/${frame}`;
      this.images.set(frame, image);
      if (this.images.size > 30) this.images.delete(this.images.keys().next().value);
    }
    return this.images.get(frame);
  }

  draw() {
    const { pen, wide, high } = penOf(this.canvas), { scale, left, top } = this.fit(), image = this.image();
    pen.fillStyle = ON_PICTURE.paper;
    pen.fillRect(0, 0, wide, high);
    pen.imageSmoothingEnabled = scale < 3;
    if (image.complete && image.naturalWidth) pen.drawImage(image, -scale * (left + 0.5), -scale * (top + 0.5), scale * this.size[0], scale * this.size[1]);
    const at = this.names.map((_, joint) => {
      const point = this.grabbed === joint && this.start ? this.start : this.point(joint);
      return point ? this.place(point) : null;
    });
    pen.strokeStyle = ON_PICTURE.middle;
    pen.lineWidth = 1.5;
    for (const [a, b] of this.edges) if (at[a] && at[b]) { pen.beginPath(); pen.moveTo(...at[a]); pen.lineTo(...at[b]); pen.stroke(); }
    at.forEach((place, joint) => {
      if (!place) return;
      pen.strokeStyle = joint === this.joint ? ON_PICTURE.doubt : ON_PICTURE.ring;
      pen.lineWidth = 2;
      pen.beginPath();
      pen.arc(...place, 5, 0, 2 * Math.PI);
      pen.stroke();
      if (joint === this.joint) label(pen, this.names[joint], place[0] + 12, Math.max(12, place[1] - 12), wide, ON_PICTURE.doubt);
    });
    const done = this.count(this.frame);
    this.root.querySelector(".status").textContent = `frame ${this.frame}, ${this.number + 1} of ${this.frames.length}: ${done} of ${this.names.length} keypoints`;
    document.querySelector(".wanted").textContent = this.names[this.joint];
  }

  list() {
    this.root.querySelector(".queue").replaceChildren(...this.frames.map((frame, number) => {
      const entry = document.createElement("li"), button = document.createElement("button");
      button.type = "button";
      button.textContent = `frame ${frame}: ${this.count(frame)} of ${this.names.length}`;
      button.addEventListener("click", () => this.go(number));
      entry.setAttribute("aria-current", String(number === this.number));
      entry.append(button);
      return entry;
    }));
  }
}

const root = document.querySelector("main.fix");
root.editor = new LabelPage(root, JSON.parse(document.getElementById("state").textContent));
