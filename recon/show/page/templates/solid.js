"use strict";
(() => {
  const section = document.querySelector(".solid"), canvas = section.querySelector("canvas");
  const slider = section.querySelector("input"), button = section.querySelector("button"), said = section.querySelector("output");
  const clip = JSON.parse(section.querySelector("script").textContent), count = clip.frames.length;
  const bytes = Uint8Array.from(atob(clip.positions), (c) => c.charCodeAt(0)), view = new DataView(bytes.buffer);
  const at = (frame, joint) => [0, 1, 2].map((axis) => clip.origin_m[axis]
    + clip.unit_m * view.getInt16(2 * (3 * (frame * clip.joints + joint) + axis), true));
  const poses = clip.frames.map((_, frame) => Array.from({ length: clip.joints }, (_, joint) => at(frame, joint)));
  const middle = (pose) => [0, 1, 2].map((axis) => pose.reduce((sum, joint) => sum + joint[axis], 0) / pose.length);
  const middles = poses.map(middle), size = Math.max(...poses.map((pose, i) =>
    Math.max(...pose.map((joint) => Math.hypot(...joint.map((x, axis) => x - middles[i][axis]))))));
  const colours = { left: "#56b4e9", right: "#e69f00", middle: "#009e73" };
  const [first, last] = [middles[0], middles[count - 1]];
  // From the side at first: the animal runs to the right.
  let turn = Math.atan2(last[1] - first[1], last[0] - first[0]), tilt = 0.25, frame = 0, timer = null;

  function draw() {
    const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, high = canvas.clientHeight;
    canvas.width = wide * ratio;
    canvas.height = high * ratio;
    const pen = canvas.getContext("2d"), scale = 0.5 * Math.min(wide / 1.4, high) / size, centre = middles[frame];
    pen.scale(ratio, ratio);
    const seen = (point) => {
      const [x, y, z] = point.map((value, axis) => value - centre[axis]);
      const along = x * Math.cos(turn) + y * Math.sin(turn), depth = y * Math.cos(turn) - x * Math.sin(turn);
      const near = 1 / (1 + (depth * Math.cos(tilt) - z * Math.sin(tilt)) / (8 * size));
      return [wide / 2 + scale * near * along, high / 2 - scale * near * (z * Math.cos(tilt) + depth * Math.sin(tilt)), near];
    };
    const line = (points, colour, width) => {
      pen.beginPath();
      points.forEach((point, i) => pen[i ? "lineTo" : "moveTo"](...seen(point).slice(0, 2)));
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.stroke();
    };
    pen.lineCap = pen.lineJoin = "round";
    const soft = getComputedStyle(section).getPropertyValue("--line"), ground = clip.ground_m[frame];
    const step = clip.grid_m, reach = Math.ceil(2.2 * size / step), [cx, cy] = centre.map((x) => Math.round(x / step));
    for (let i = -reach; i <= reach; i++) {
      line([[(cx + i) * step, (cy - reach) * step, ground], [(cx + i) * step, (cy + reach) * step, ground]], soft, 1);
      line([[(cx - reach) * step, (cy + i) * step, ground], [(cx + reach) * step, (cy + i) * step, ground]], soft, 1);
    }
    const limbs = clip.limbs.map(([side, joints]) => [side, joints.map((joint) => poses[frame][joint])]);
    for (const [, joints] of limbs) line(joints.map(([x, y]) => [x, y, ground]), soft, 4);
    const far = ([, joints]) => joints.reduce((sum, joint) => sum + seen(joint)[2], 0) / joints.length;
    for (const [side, joints] of limbs.sort((a, b) => far(a) - far(b))) line(joints, colours[side], 3.5);
    said.textContent = `frame ${clip.frames[frame]}, ${(clip.frames[frame] / (clip.fps * clip.every)).toFixed(3)} s`;
    slider.value = frame;
  }
  function show(next) {
    frame = (next + count) % count;
    draw();
  }
  function play(on) {
    clearInterval(timer);
    // A quarter of real time: a gallop's strides last a third of a second.
    timer = on ? setInterval(() => show(frame + 1), Math.max(20, 4000 / clip.fps)) : null;
    button.textContent = on ? "Pause" : "Play";
  }
  const turned = (by, up) => {
    turn += by;
    tilt = Math.min(Math.PI / 2, Math.max(-0.3, tilt + up));
    draw();
  };
  slider.max = count - 1;
  slider.oninput = () => { play(false); show(Number(slider.value)); };
  button.onclick = () => play(timer === null);
  canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
  canvas.onpointermove = (event) => { if (event.buttons) turned(event.movementX / 150, event.movementY / 150); };
  canvas.onkeydown = (event) => {
    const by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (by) { event.preventDefault(); turned(...by); }
  };
  window.addEventListener("resize", draw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  section.hidden = false;
  draw();
})();
