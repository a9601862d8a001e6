// Controls: buttons, keys, the address (#t=seconds), and links in the page's text to frames and keypoints.

import { SPEEDS } from "./cursor.js";

/** Connect the buttons of the player to the cursor and the views. */
export class Controls {
  constructor(root, clip, cursor, picture, scene) {
    Object.assign(this, { root, clip, cursor, picture, scene });
    this.play = root.querySelector("[data-do=play]");
    this.slider = root.querySelector("input[type=range]");
    this.status = root.querySelector(".status");
    this.slider.max = clip.count - 1;
    this.slider.addEventListener("input", () => cursor.go(Number(this.slider.value)));
    const actions = {
      play: () => cursor.play(!cursor.playing),
      back: () => cursor.step(-1),
      next: () => cursor.step(1),
      flagged: () => this.nextFlagged(),
      link: () => this.copyLink(),
      side: () => scene.preset("side"),
      front: () => scene.preset("front"),
      top: () => scene.preset("top"),
      camera: () => scene.preset("camera"),
      closer: () => scene.zoomBy(1.25),
      farther: () => scene.zoomBy(0.8),
      "picture-closer": () => picture.zoom(1.4),
      "picture-all": () => picture.reset(),
    };
    for (const button of root.querySelectorAll("[data-do]")) button.addEventListener("click", actions[button.dataset.do]);
    this.flagged = root.querySelector("[data-do=flagged]");
    this.flagged.hidden = !clip.flags.length;
    for (const box of root.querySelectorAll("input[data-show]")) {
      box.addEventListener("change", () => {
        if (box.dataset.show === "marks") picture.marks = box.checked;
        else if (box.dataset.show === "follow") picture.follow = box.checked;
        else scene.show[box.dataset.show] = box.checked;
        cursor.tell("state");
      });
    }
    const follow = root.querySelector("[data-show=follow]");
    follow.checked = picture.follow;
    picture.followed = (on) => { follow.checked = on; };
    this.speeds = root.querySelector("select[data-choose=speed]");
    for (const speed of SPEEDS) this.speeds.add(new Option(speed === 1 ? "1 (real time)" : `1/${1 / speed}`, String(speed)));
    this.speeds.value = String(cursor.speed);
    this.speeds.addEventListener("change", () => cursor.setSpeed(Number(this.speeds.value)));
    this.cameras = root.querySelector("select[data-choose=camera]");
    clip.cameras.forEach((camera, number) => this.cameras.add(new Option(camera.name, String(number))));
    this.cameras.value = String(cursor.camera);
    this.cameras.addEventListener("change", () => cursor.setCamera(Number(this.cameras.value)));
    this.cameras.parentElement.hidden = clip.cameras.length < 2;
    const file = root.querySelector("input[type=file]");
    file.addEventListener("change", () => file.files.length && this.openVideo(file.files[0]));
    document.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => this.followAddress());
    cursor.on("row", () => this.update());
    cursor.on("state", () => this.update());
  }

  openVideo(file) {
    this.picture.openVideo(file, (problem, video) => {
      const { size } = this.clip.cameras[this.cursor.camera];
      if (!problem && Math.abs(video.videoWidth / video.videoHeight - size[0] / size[1]) > 0.01) {
        problem = `${file.name} is ${video.videoWidth}x${video.videoHeight}, the camera's picture ${size.join("x")}. Is it the right video?`;
      }
      this.root.querySelector(".problem").textContent = problem || "";
      this.picture.draw();
    });
  }

  /** Handle the keys of the whole page, except keys that a field or button uses. */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const tag = event.target.tagName, field = /^(INPUT|SELECT|TEXTAREA)$/.test(tag);
    if (field && !(event.target.type === "checkbox" && event.key !== " ")) return;
    if (tag === "BUTTON" && event.key === " ") return;
    const far = event.shiftKey ? 10 : 1, { cursor } = this;
    const actions = {
      " ": () => cursor.play(!cursor.playing),
      ArrowLeft: () => cursor.step(-far),
      ArrowRight: () => cursor.step(far),
      Home: () => cursor.go(0),
      End: () => cursor.go(this.clip.count - 1),
      "<": () => this.faster(-1),
      ">": () => this.faster(1),
      d: () => this.nextFlagged(),
    };
    const action = actions[event.key];
    if (!action || (event.key === "Home" || event.key === "End") && !this.root.contains(event.target)) return;
    event.preventDefault();
    action();
  }

  faster(by) {
    const at = SPEEDS.indexOf(this.cursor.speed) + by;
    if (at >= 0 && at < SPEEDS.length) this.cursor.setSpeed(SPEEDS[at]);
  }

  nextFlagged() {
    const { cursor, clip } = this, next = clip.flags.find(([first]) => first > cursor.row) || clip.flags[0];
    if (next) cursor.go(next[0]);
  }

  get address() {
    return `#t=${this.clip.time(this.cursor.row).toFixed(4)}`;
  }

  /** Show the frame at the time that the address states, in seconds of the clip. */
  followAddress() {
    const found = /[#&]t=(-?[\d.]+)/.exec(window.location.hash);
    if (found) this.cursor.go(this.clip.rowOfFrame(Math.round(Number(found[1]) * this.clip.fps)));
  }

  copyLink() {
    window.history.replaceState(null, "", this.address);
    const text = window.location.href, tell = (words) => { this.root.querySelector(".problem").textContent = words; };
    if (!navigator.clipboard) { tell(`The address leads to this frame: ${this.address}`); return; }
    navigator.clipboard.writeText(text).then(() => tell("The link to this frame is copied."),
      () => tell(`The address leads to this frame: ${this.address}`));
  }

  update() {
    const { clip, cursor } = this, flags = clip.flagsAt(cursor.row);
    const text = `frame ${clip.frames[cursor.row]}, ${clip.time(cursor.row).toFixed(3)} s${flags ? `, ${flags}` : ""}`;
    this.slider.value = String(cursor.row);
    this.slider.setAttribute("aria-valuetext", text);
    this.status.setAttribute("aria-live", cursor.playing ? "off" : "polite"); // otherwise every frame would be read out
    this.status.textContent = text;
    this.play.textContent = cursor.playing ? "Pause" : "Play";
    this.speeds.value = String(cursor.speed);
    this.cameras.value = String(cursor.camera);
  }
}

/** Turn the page's findings, flagged frames and keypoints into buttons that show their frame in the player. */
export function linkText(clip, cursor, player) {
  const show = (row, keypoints) => {
    if (keypoints) cursor.name(keypoints);
    cursor.go(row);
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    player.scrollIntoView({ block: "start", behavior: still ? "instant" : "smooth" });
  };
  const button = (text, action) => {
    const element = document.createElement("button");
    Object.assign(element, { type: "button", className: "go", textContent: text });
    element.addEventListener("click", action);
    return element;
  };
  for (const element of document.querySelectorAll("[data-finding]")) {
    const finding = clip.findings[Number(element.dataset.finding)];
    const keypoints = finding.keypoints.map((name) => clip.keypoints.indexOf(name));
    if (!finding.frames && !keypoints.length) continue;
    const camera = clip.cameras.findIndex(({ name }) => name === finding.camera);
    const row = finding.frames ? clip.rowOfFrame(finding.frames[0]) : worstRow(clip, Math.max(camera, cursor.camera), keypoints);
    const names = finding.keypoints.slice(0, 3).join(", ");
    element.append(" ", button(`Show frame ${clip.frames[row]}${names ? `, ${names}` : ""}`, () => {
      if (camera >= 0 && camera !== cursor.camera) cursor.setCamera(camera);
      show(row, keypoints);
    }));
  }
  for (const cell of document.querySelectorAll("[data-row]")) {
    cell.replaceChildren(button(cell.textContent, () => show(Number(cell.dataset.row))));
  }
  for (const cell of document.querySelectorAll("[data-keypoint]")) {
    const joint = Number(cell.dataset.keypoint), camera = Number(cell.dataset.camera);
    cell.replaceChildren(button(cell.textContent, () => {
      if (camera !== cursor.camera) cursor.setCamera(camera);
      show(worstRow(clip, camera, [joint]), [joint]);
    }));
  }
}

/** Return the row in which these keypoints are farthest from the pose. */
export function worstRow(clip, number, joints) {
  const camera = clip.cameras[number];
  let worst = 0, most = -1;
  if (!camera.known) return worst;
  for (let row = 0; row < clip.count; row++) {
    for (const joint of joints) {
      const error = camera.error(row, joint);
      if (error > most) [worst, most] = [row, error];
    }
  }
  return worst;
}
