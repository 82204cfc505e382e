/* What pages with a game share: drawing a world as an agent sees it, and the keys that steer the agent. */
"use strict";

const TRAPEZOID = [[-1.5, -1], [-0.5, 1], [0.5, 1], [1.5, -1]], EYES = [[-0.24, 0.62], [0.24, 0.62]], EYE = 0.14;
const KEYS = { // by place on the keyboard, whatever is printed there
  KeyW: "forward", ArrowUp: "forward", KeyS: "backward", ArrowDown: "backward", KeyA: "left", KeyD: "right",
  KeyQ: "turn left", ArrowLeft: "turn left", KeyE: "turn right", ArrowRight: "turn right", Space: "grab",
};
const HELP = [["W", "\u2191", "forward"], ["S", "\u2193", "backward"], ["A", "", "left"], ["D", "", "right"],
  ["Q", "\u2190", "turn left"], ["E", "\u2192", "turn right"], ["space", "", "grab, or let go"]];

/** Return an element with attributes (functions: what listens) and children. */
function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else if (name === "html") made.innerHTML = value; // rendered from Markdown, where HTML is escaped
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value != null) made.setAttribute(name, value);
  }
  made.append(...children.filter(child => child != null));
  return made;
}

const css = colour => `rgb(${colour.join(" ")})`;

/** Draws what one agent sees, as smoothly as the screen can. */
class View {
  constructor(canvas) { this.canvas = canvas; this.scene = null; this.frames = []; this.big = ""; }

  begin(scene) {
    Object.assign(this, { scene, frames: [], big: "" });
    if (!scene) return;
    const [x0, x1, y0, y1] = scene.arena;
    this.shape = (y1 - y0 + 0.4) / (x1 - x0 + 0.4); // height for width, borders included
    this.canvas.style.aspectRatio = String(1 / this.shape);
  }

  add(frame) { this.frames = [...this.frames.slice(-1), { ...frame, at: performance.now() }]; }

  draw() {
    const { canvas, scene } = this, pen = canvas.getContext("2d");
    const side = Math.round(canvas.clientWidth * (window.devicePixelRatio || 1)), height = Math.round(side * (this.shape ?? 1));
    if (side && (canvas.width !== side || canvas.height !== height)) Object.assign(canvas, { width: side, height });
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = "#fff";
    pen.fillRect(0, 0, canvas.width, canvas.height);
    const frame = this.frames.at(-1);
    if (!scene || !frame) return;
    const [x0, x1, y0, y1] = scene.arena, unit = canvas.width / (x1 - x0 + 0.4);
    pen.setTransform(unit, 0, 0, -unit, (0.2 - x0) * unit, (0.2 + y1) * unit); // y points up
    for (const [k, [x, y]] of scene.landmarks.entries()) {
      const half = scene.half_widths[k];
      pen.fillStyle = css(scene.landmark_colours[k]);
      pen.fillRect(x - half, y - half, 2 * half, 2 * half);
    }
    if (frame.sight) { // what is out of sight lies in the shade
      pen.beginPath();
      pen.rect(x0, y0, x1 - x0, y1 - y0);
      for (const [k, corner] of frame.sight.entries()) pen[k ? "lineTo" : "moveTo"](...corner);
      pen.closePath();
      pen.fillStyle = "rgb(70 75 85 / 0.55)";
      pen.fill("evenodd");
    }
    const poses = this.poses(frame);
    const order = [...poses.keys()], items = order.splice(scene.n_agents);
    for (const entity of [...items, ...order]) if (poses[entity]) this.entity(pen, entity, poses[entity]);
    for (const [agent, item] of frame.held.entries()) {
      if (item < 0 || !poses[agent] || !poses[item]) continue;
      pen.beginPath();
      pen.moveTo(...poses[agent]);
      pen.lineTo(...poses[item]);
      pen.strokeStyle = "#000";
      pen.lineWidth = 0.12;
      pen.stroke();
    }
    pen.strokeStyle = "#000";
    pen.lineWidth = 0.25;
    pen.lineCap = "square";
    pen.strokeRect(x0, y0, x1 - x0, y1 - y0);
    for (const [start, end] of scene.walls) { pen.beginPath(); pen.moveTo(...start); pen.lineTo(...end); pen.stroke(); }
    if (this.big) this.overlay(pen);
  }

  /** Between the last two frames: one behind, so that motion is even. */
  poses(frame) {
    const before = this.frames.length > 1 ? this.frames[0] : frame;
    const share = Math.min(1, (performance.now() - frame.at) / (1000 * this.scene.interval));
    return frame.poses.map((pose, entity) => pose && before.poses[entity]
      ? pose.map((value, k) => before.poses[entity][k] + share * (value - before.poses[entity][k])) : pose);
  }

  entity(pen, entity, [x, y, angle]) {
    const radius = this.scene.radius[entity], isAgent = entity < this.scene.n_agents;
    pen.save();
    pen.translate(x, y);
    pen.rotate(angle);
    pen.scale(radius, radius);
    if (entity === this.scene.agent) { // one's own has a ring
      pen.beginPath();
      pen.arc(0, 0, 2.1, 0, 2 * Math.PI);
      pen.setLineDash([0.5, 0.3]);
      pen.lineWidth = 0.14 / radius;
      pen.strokeStyle = "#0b57d0";
      pen.stroke();
      pen.setLineDash([]);
    }
    pen.beginPath();
    if (isAgent) for (const [k, corner] of TRAPEZOID.entries()) pen[k ? "lineTo" : "moveTo"](...corner);
    else pen.arc(0, 0, 1, 0, 2 * Math.PI);
    pen.closePath();
    pen.fillStyle = css(this.scene.colours[entity]);
    pen.fill();
    pen.fillStyle = "#000";
    if (isAgent) for (const [ex, ey] of EYES) { pen.beginPath(); pen.arc(ex, ey, EYE, 0, 2 * Math.PI); pen.fill(); }
    pen.restore();
  }

  overlay(pen) {
    const { width: side, height } = this.canvas;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.font = `bold ${side / 6}px sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.lineWidth = side / 60;
    pen.strokeStyle = "#fff";
    pen.strokeText(this.big, side / 2, height / 2);
    pen.fillStyle = "#000";
    pen.fillText(this.big, side / 2, height / 2);
  }
}
