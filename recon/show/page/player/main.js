// Assemble the player from one clip, one cursor, the views and the controls.

import { Controls, linkText } from "./controls.js";
import { Cursor } from "./cursor.js";
import { Clip } from "./data.js";
import { KeypointMap } from "./map.js";
import { PictureView } from "./picture.js";
import { SceneView } from "./scene.js";
import { CurveStrip, ErrorStrip, FlagStrip, FootStrip, isFilled } from "./strips.js";

const player = document.querySelector(".player");

/** Make an empty strip: a canvas, and elements for its name and value. */
function newStrip(name, height) {
  const strip = document.createElement("div"), head = document.createElement("div");
  const title = document.createElement("span"), output = document.createElement("output"), canvas = document.createElement("canvas");
  [strip.className, head.className, title.textContent] = ["strip", "strip-head", name];
  canvas.style.height = `${height}px`;
  canvas.setAttribute("role", "img");
  output.setAttribute("aria-live", "off");
  head.append(title, output);
  strip.append(head, canvas);
  return { strip, canvas, title, output };
}

/** Add a strip under the pictures. */
function addStrip(name, height) {
  const made = newStrip(name, height);
  player.querySelector(".strips").append(made.strip);
  return made;
}

/** Add a strip whose curve is chosen from a list. */
function addChoice(clip, cursor, panels, chosen) {
  const { canvas, title, output } = addStrip("", 84), select = document.createElement("select");
  for (const panel of panels) select.add(new Option(panel.title));
  select.selectedIndex = chosen;
  select.setAttribute("aria-label", "angle shown");
  title.append(select);
  const strip = new CurveStrip(canvas, clip, cursor, output, panels[chosen]);
  select.addEventListener("change", () => { strip.setPanel(panels[select.selectedIndex]); strip.draw(); });
  return strip;
}

/** Draw every angle in its own panel, side by side. */
function addPanels(clip, cursor, panels, strips) {
  const section = document.querySelector(".angles");
  if (!section || !panels.length) return;
  section.hidden = false;
  const unknown = panels.filter(isFilled);
  if (unknown.length) {
    const names = unknown.map(({ title }) => title).join(", ");
    section.querySelector(".unknown").textContent = `Not drawn, because their 90 % bands would fill the panels: ${names}.`;
  }
  for (const panel of panels.filter((each) => !unknown.includes(each))) {
    const { strip, canvas, output } = newStrip(panel.title, 96);
    section.querySelector(".small").append(strip);
    strips.push(new CurveStrip(canvas, clip, cursor, output, panel));
  }
}

/** Show the keypoints of one camera in the table. */
function showTable(camera) {
  for (const body of document.querySelectorAll("tbody[data-camera]")) body.hidden = Number(body.dataset.camera) !== camera;
}

function start() {
  const clip = new Clip(JSON.parse(document.getElementById("clip").textContent)), cursor = new Cursor(clip);
  document.documentElement.classList.add("plays");
  player.hidden = false;
  const picture = new PictureView(player.querySelector("canvas.picture"), clip, cursor);
  picture.chooseFollow();
  const scene = new SceneView(player.querySelector("canvas.scene"), clip, cursor);
  const strips = [];
  const speed = clip.curves.find((panel) => panel.group === "speed");
  if (speed) {
    const { canvas, output } = addStrip(speed.title, 84);
    strips.push(new CurveStrip(canvas, clip, cursor, output, speed));
  }
  if (clip.stances.length) {
    const { canvas, output } = addStrip("footfalls", 18 * clip.feet.length + 8);
    canvas.setAttribute("aria-label", "Stances of each foot. A click on a bar shows its touch-down.");
    strips.push(new FootStrip(canvas, clip, cursor, output));
  }
  const angles = clip.curves.filter((panel) => panel.group !== "speed");
  angles.slice(0, 2).forEach((_, i) => strips.push(addChoice(clip, cursor, angles, i)));
  if (clip.flags.length) {
    const { canvas, output } = addStrip("flagged frames", 24);
    canvas.setAttribute("aria-label", "Flagged frames. A click on a bar shows its first frame.");
    strips.push(new FlagStrip(canvas, clip, cursor, output));
  }
  const error = addStrip("median keypoint error", 64);
  strips.push(new ErrorStrip(error.canvas, clip, cursor, error.output));
  const quality = document.querySelector(".quality"), map = new KeypointMap(quality.querySelector("canvas"), clip, cursor,
    quality.querySelector(".map-value"), quality.querySelector(".scale"));
  quality.querySelector(".map").hidden = false;
  for (const choice of quality.querySelectorAll("input[name=quantity]")) {
    choice.addEventListener("change", () => map.setQuantity(choice.value));
  }
  strips.push(map);

  addPanels(clip, cursor, angles, strips);

  // Draw all views together, at most once for each refresh of the screen. Strips outside the screen wait.
  let due = false, all = false;
  const draw = (always = false) => {
    const whole = all;
    [due, all] = [false, false];
    picture.draw();
    scene.draw();
    for (const strip of strips) {
      strip.stale = strip.stale || whole;
      strip.paint(always);
    }
    for (const strip of strips) strip.write();
  };
  const plan = (whole) => {
    all = all || whole;
    if (!due) { due = true; requestAnimationFrame(() => draw()); }
  };
  const seen = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) strips.find(({ canvas }) => canvas === target).visible = isIntersecting;
    plan(false);
  }, { rootMargin: "100px" });
  for (const strip of strips) {
    strip.visible = false;
    seen.observe(strip.canvas);
  }
  let { camera } = cursor;
  const followCamera = () => {
    if (camera === cursor.camera) return false;
    ({ camera } = cursor);
    picture.window = null;
    picture.length = picture.animalLength;
    return true;
  };
  showTable(camera);
  cursor.on("row", () => { picture.seek(); plan(false); });
  cursor.on("state", () => {
    const changed = followCamera();
    if (changed) {
      showTable(camera);
      for (const strip of strips) if (strip.cameraChanged) strip.cameraChanged();
    }
    plan(changed);
  });
  const controls = new Controls(player, clip, cursor, picture, scene);
  linkText(clip, cursor, player);
  let wide = player.clientWidth;
  new ResizeObserver(() => {
    if (wide !== player.clientWidth) plan(true);
    wide = player.clientWidth;
  }).observe(player);
  for (const query of ["(prefers-color-scheme: dark)", "print"]) {
    window.matchMedia(query).addEventListener("change", () => { all = true; draw(query === "print"); });
  }
  window.addEventListener("beforeprint", () => { all = true; draw(true); });
  const posed = clip.frames.findIndex((_, row) => clip.hasPose(row));
  cursor.row = Math.max(0, posed);
  scene.preset("side");
  controls.followAddress();
  controls.update();
  all = true;
  draw();
  // Strips below the screen are drawn once when there is time, for pictures of the whole page.
  const waiting = strips.filter((strip) => !strip.visible);
  const drawNext = () => {
    const strip = waiting.shift();
    if (!strip) return;
    strip.draw(true);
    setTimeout(drawNext, 10);
  };
  setTimeout(drawNext, 500);
  player.reconPlayer = { clip, cursor, picture, scene, strips, map, draw };
}

if (player) start();
