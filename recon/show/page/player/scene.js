// View: the pose in 3D, which can be turned, zoomed and moved by hand or keys, or seen from preset sides.

import { FONT, colours, gestures, penOf } from "./theme.js";

const UNCERTAIN_FROM = 1; // px: smaller ellipses are not drawn

export class SceneView {
  constructor(canvas, clip, cursor) {
    Object.assign(this, { canvas, clip, cursor });
    this.show = { trail: true, uncertainty: false, ground: true, cameras: true };
    this.preset("side");
    gestures(canvas, {
      drag: (dx, dy, pans) => (pans ? this.pan(dx, dy) : this.turn(dx / 150, dy / 150)),
      zoom: (factor) => this.zoomBy(factor),
      hover: (x, y) => cursor.hover(this.keypointAt(x, y)),
      leave: () => cursor.hover(-1),
      tap: (x, y) => { const joint = this.keypointAt(x, y, 24); cursor.name(joint < 0 ? [] : [joint]); },
    });
    canvas.addEventListener("keydown", (event) => {
      const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      const zooms = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 }[event.key];
      if (turns && event.shiftKey) this.pan(-200 * turns[0], 200 * turns[1]);
      else if (turns) this.turn(...turns);
      else if (zooms) this.zoomBy(zooms);
      else return;
      event.preventDefault();
      event.stopPropagation(); // elsewhere, arrow keys step through the frames
    });
  }

  /** Look from the side, the front, above, or the camera's position. */
  preset(name) {
    const { clip, cursor } = this;
    const heading = this.heading();
    Object.assign(this, { angle: heading, tilt: 0.06, zoomed: 1, panned: [0, 0] });
    if (name === "front") this.angle = heading + Math.PI / 2;
    if (name === "top") this.tilt = Math.PI / 2;
    if (name === "camera") {
      const pose = clip.cameraPose(cursor.camera, cursor.row);
      if (pose) {
        const centre = clip.middle(cursor.row), away = centre.map((x, axis) => x - pose.centre[axis]);
        this.angle = Math.atan2(away[1], away[0]) - Math.PI / 2;
        this.tilt = Math.atan2(-away[2], Math.hypot(away[0], away[1]));
      }
    } else if (name === "side" && this.seenFromLeft()) this.angle = heading + Math.PI;
    this.draw();
  }

  /** Return the direction of the run, or of the trunk if the animal does not move on. */
  heading() {
    const { clip } = this, rows = [];
    for (let row = 0; row < clip.count; row++) if (clip.hasPose(row)) rows.push(row);
    if (!rows.length) return 0;
    const first = clip.middle(rows[0]), last = clip.middle(rows[rows.length - 1]);
    let [x, y] = [last[0] - first[0], last[1] - first[1]];
    if (Math.hypot(x, y) < 0.5 * clip.length) {
      const [rear, front] = clip.trunk.map((joint) => clip.joint(rows[0], joint));
      [x, y] = [front[0] - rear[0], front[1] - rear[1]];
    }
    return Math.atan2(y, x);
  }

  /** Return whether the animal runs to the left in the camera's picture, as it then does in the view from the side. */
  seenFromLeft() {
    const pose = this.clip.cameraPose(this.cursor.camera, this.cursor.row), angle = this.heading();
    return pose !== null && Math.cos(angle) * pose.right[0] + Math.sin(angle) * pose.right[1] < -0.2;
  }

  turn(by, up) {
    this.angle += by;
    this.tilt = Math.min(Math.PI / 2, Math.max(-0.3, this.tilt + up));
    this.draw();
  }

  zoomBy(factor) {
    this.zoomed = Math.min(30, Math.max(0.05, this.zoomed * factor));
    this.draw();
  }

  pan(dx, dy) {
    this.panned = [this.panned[0] + dx, this.panned[1] + dy];
    this.draw();
  }

  /** Prepare the projection onto the canvas: `seen(point)` returns [x, y, nearness]. */
  prepare(wide, high) {
    const { angle, tilt } = this, centre = this.clip.middle(this.cursor.row);
    const scale = (0.62 * Math.min(wide / 1.15, 1.6 * high) * this.zoomed) / this.clip.length;
    const [ca, sa, ct, st] = [Math.cos(angle), Math.sin(angle), Math.cos(tilt), Math.sin(tilt)], far = 8 * this.clip.length;
    this.axes = { right: [ca, sa, 0], up: [-sa * st, ca * st, ct], scale };
    this.seen = (point) => {
      const x = point[0] - centre[0], y = point[1] - centre[1], z = point[2] - centre[2];
      const along = x * ca + y * sa, depth = y * ca - x * sa;
      const near = 1 / Math.max(0.05, 1 + (depth * ct - z * st) / far);
      return [wide / 2 + this.panned[0] + scale * near * along,
        high / 2 + this.panned[1] - scale * near * (z * ct + depth * st), near];
    };
    return centre;
  }

  keypointAt(x, y, reach = 12) {
    if (!this.seen || !this.clip.hasPose(this.cursor.row)) return -1;
    let best = -1, least = reach;
    for (let j = 0; j < this.clip.joints; j++) {
      const at = this.seen(this.clip.joint(this.cursor.row, j)), away = Math.hypot(at[0] - x, at[1] - y);
      if (away < least) [best, least] = [j, away];
    }
    return best;
  }

  draw() {
    const { canvas, clip, cursor, show } = this;
    if (!canvas.clientWidth) return;
    const { pen, wide, high } = penOf(canvas), paint = colours(canvas);
    pen.clearRect(0, 0, wide, high);
    pen.lineCap = pen.lineJoin = "round";
    const centre = this.prepare(wide, high), plane = clip.groundAt(cursor.row);
    if (plane && show.ground) this.drawGround(pen, centre, plane, paint);
    if (show.cameras) clip.scenery.forEach((_, number) => this.drawCamera(pen, number, paint));
    if (show.trail) this.drawTrail(pen, paint);
    if (clip.hasPose(cursor.row)) {
      if (show.uncertainty) this.drawUncertainty(pen, paint);
      this.drawLimbs(pen, paint);
      for (const j of new Set([...cursor.named, cursor.hovered])) if (j >= 0) this.drawName(pen, j, paint, wide);
    } else {
      pen.font = FONT;
      pen.fillStyle = paint.ink;
      pen.fillText("no pose in this frame", 10, 20);
    }
  }

  line(pen, points, colour, width) {
    pen.beginPath();
    points.forEach((point, i) => pen[i ? "lineTo" : "moveTo"](...this.seen(point).slice(0, 2)));
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.stroke();
  }

  heightAt(plane, x, y) {
    return plane.height_m + plane.slope[0] * x + plane.slope[1] * y;
  }

  get gridStep() {
    return this.clip.length > 0.3 ? 1 : this.clip.length > 0.03 ? 0.1 : 0.01;
  }

  drawGround(pen, centre, plane, paint) {
    const step = this.gridStep, reach = Math.ceil((2.4 * this.clip.length) / step);
    const [cx, cy] = centre.slice(0, 2).map((x) => Math.round(x / step));
    const at = (i, j) => { const [x, y] = [(cx + i) * step, (cy + j) * step]; return [x, y, this.heightAt(plane, x, y)]; };
    for (let i = -reach; i <= reach; i++) {
      this.line(pen, [at(i, -reach), at(i, reach)], paint.grid, 0.7);
      this.line(pen, [at(-reach, i), at(reach, i)], paint.grid, 0.7);
    }
    if (!this.clip.hasPose(this.cursor.row)) return;
    for (const limb of this.clip.limbs) { // the shadow
      const points = limb.joints.map((joint) => this.clip.joint(this.cursor.row, joint));
      this.line(pen, points.map(([x, y]) => [x, y, this.heightAt(plane, x, y)]), paint.line, 5);
    }
  }

  drawCamera(pen, number, paint) {
    const pose = this.clip.cameraPose(number, this.cursor.row);
    if (!pose) return;
    const size = 0.35 * this.clip.length, [a, b] = pose.half;
    const corner = (i, j) => pose.centre.map((x, axis) => x + size * (pose.ahead[axis] + i * a * pose.right[axis] + j * b * pose.down[axis]));
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([i, j]) => corner(i, j));
    this.line(pen, [...corners, corners[0]], paint.soft, 1.2);
    for (const end of corners) this.line(pen, [pose.centre, end], paint.soft, 1.2);
    const [x, y] = this.seen(pose.centre);
    pen.font = FONT;
    pen.fillStyle = paint.soft;
    pen.fillText(this.clip.cameras[number].name, x + 6, y - 6);
  }

  /** Draw the path of the reference joint, and of the named keypoints over the last half second. */
  drawTrail(pen, paint) {
    const { clip, cursor } = this, recent = Math.round(clip.fps / 2);
    const paths = [[clip.reference, 0, clip.count, paint.soft, 1.2]];
    for (const j of cursor.named) paths.push([j, cursor.row - recent, cursor.row + 1, paint[clip.sides[j]], 2]);
    const step = Math.max(1, Math.floor(clip.count / 1000));
    for (const [joint, first, stop, colour, width] of paths) {
      let points = [];
      for (let row = Math.max(0, first); row < stop; row += stop - first > 1000 ? step : 1) {
        if (clip.hasPose(row)) points.push(clip.joint(row, joint));
        else { if (points.length > 1) this.line(pen, points, colour, width); points = []; }
      }
      if (points.length > 1) this.line(pen, points, colour, width);
    }
  }

  drawLimbs(pen, paint) {
    const { clip, cursor } = this;
    const limbs = clip.limbs.map((limb) => ({ side: limb.side, points: limb.joints.map((j) => clip.joint(cursor.row, j)) }));
    const near = ({ points }) => points.reduce((sum, point) => sum + this.seen(point)[2], 0) / points.length;
    for (const limb of limbs.sort((a, b) => near(a) - near(b))) {
      this.line(pen, limb.points, paint.paper, 5.5);
      this.line(pen, limb.points, paint[limb.side], 3.5);
    }
  }

  /** Draw the ellipses that contain each joint, relative to the pose, with a probability of 90 %. */
  drawUncertainty(pen, paint) {
    const { clip, cursor } = this, { right, up, scale } = this.axes;
    const at = Math.min(Math.floor(cursor.row / clip.spreadEvery), clip.spread.length / 6 / clip.joints - 1);
    for (let j = 0; j < clip.joints; j++) {
      const i = 6 * (at * clip.joints + j), s = clip.spread;
      if (Number.isNaN(s[i])) continue;
      const columns = [[s[i], s[i + 1], s[i + 3]], [0, s[i + 2], s[i + 4]], [0, 0, s[i + 5]]];
      let [xx, xy, yy] = [0, 0, 0];
      for (const column of columns) {
        const x = column.reduce((sum, v, axis) => sum + v * right[axis], 0), y = column.reduce((sum, v, axis) => sum + v * up[axis], 0);
        xx += x * x; xy += x * y; yy += y * y;
      }
      const middle = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy), factor = clip.radius90 * scale;
      const [a, b] = [Math.sqrt(middle + half) * factor, Math.sqrt(Math.max(0, middle - half)) * factor];
      if (a < UNCERTAIN_FROM) continue;
      const [x, y] = this.seen(clip.joint(cursor.row, j));
      pen.beginPath();
      pen.ellipse(x, y, a, b, -Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
      pen.strokeStyle = paint[clip.sides[j]];
      pen.lineWidth = 1;
      pen.stroke();
    }
  }

  drawName(pen, j, paint, wide) {
    const [x, y] = this.seen(this.clip.joint(this.cursor.row, j)), text = this.clip.keypoints[j];
    pen.strokeStyle = paint.strong;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(x, y, 7, 0, 2 * Math.PI);
    pen.stroke();
    pen.font = FONT;
    const width = pen.measureText(text).width, left = Math.min(x + 12, wide - width - 6);
    pen.fillStyle = paint.paper;
    pen.fillRect(left - 3, y - 22, width + 6, 17);
    pen.fillStyle = paint.ink;
    pen.textBaseline = "middle";
    pen.fillText(text, left, y - 13);
  }
}
