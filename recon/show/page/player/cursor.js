// The page's only cursor. It holds the frame that is shown, whether and how fast the clip plays, and the keypoints that are
// named. Views listen to the cursor; controls and views move it. It draws nothing.

export const SPEEDS = [0.125, 0.25, 0.5, 1];

export class Cursor {
  constructor(clip) {
    this.clip = clip;
    this.row = 0;
    this.speed = clip.fps > 60 ? 0.125 : 0.25; // a gallop's strides last a third of a second
    this.playing = false;
    this.named = []; // keypoints, by number, that are named in the pictures
    this.hovered = -1;
    this.camera = clip.chosen;
    this.listeners = { row: [], state: [] };
  }

  /** Register a function to be called when the row ("row") or anything else ("state") changes. */
  on(kind, listener) {
    this.listeners[kind].push(listener);
  }

  tell(kind) {
    for (const listener of this.listeners[kind]) listener(this);
  }

  /** Show a row; a row outside the clip becomes the nearest one in the clip. */
  show(row) {
    const next = Math.min(this.clip.count - 1, Math.max(0, Math.round(row)));
    if (next === this.row) return;
    this.row = next;
    this.tell("row");
  }

  /** Stop and show a row, as after a click on a curve, a stance or a finding. */
  go(row) {
    this.play(false);
    this.show(row);
    this.tell("state");
  }

  step(by) {
    this.go(this.row + by);
  }

  setSpeed(speed) {
    this.speed = speed;
    this.started = null;
    this.tell("state");
  }

  name(keypoints) {
    this.named = keypoints;
    this.tell("state");
  }

  hover(keypoint) {
    if (keypoint === this.hovered) return;
    this.hovered = keypoint;
    this.tell("state");
  }

  setCamera(number) {
    this.camera = number;
    this.tell("state");
  }

  play(on) {
    if (on === this.playing) return;
    this.playing = on;
    this.started = null;
    if (on && this.row === this.clip.count - 1) this.show(0);
    if (on) requestAnimationFrame((now) => this.advance(now));
    this.tell("state");
  }

  /** Show the frame that is due by the clock, so that a slow browser skips frames but keeps the speed. */
  advance(now) {
    if (!this.playing) return;
    const { clip } = this;
    if (this.started === null) this.started = { now, time: clip.time(this.row) };
    const due = this.started.time + ((now - this.started.now) / 1000) * this.speed;
    if (due > clip.time(clip.count - 1) + 0.5 / clip.fps) {
      this.started = null;
      this.show(0);
    } else {
      let row = this.row;
      while (row + 1 < clip.count && clip.time(row + 1) <= due) row++;
      this.show(row);
    }
    requestAnimationFrame((next) => this.advance(next));
  }
}
