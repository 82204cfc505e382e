/* A live game, and beside it what the model believes. The server has the world, the clock and the
   reader (phase_study/live.py); this script draws, sends keys, and keeps what was read. */
"use strict";

const SECOND = location.pathname === "/second";
const FRAME = 0.25, LEADING = 4;
const PARTNERS = { planner: "the planner, with a goal of its own", helper: "the planner, helping me", hinderer: "the planner, hindering me",
  player: "a second player", nobody: "nobody: it stands still" };
const RELATIONS = ["friendly", "neutral", "adversarial"], RELATION_COLOURS = ["#009e73", "#7a7a7a", "#d55e00"];
const PALETTE = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b58900"];
const percent = share => `${Math.round(100 * share)}\u00a0%`;
const seconds = frame => `${(frame * FRAME).toFixed(1)} s`;
const times = ratio => ratio >= 1 ? `${ratio < 10 ? ratio.toFixed(1) : Math.round(ratio)} times as probable` : `${1 / ratio < 10 ? (1 / ratio).toFixed(1) : Math.round(1 / ratio)} times less probable`;
const quantile = (values, share) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(share * values.length))];
const say = text => { document.getElementById("message").textContent = text; };

/** How long things took, in milliseconds. */
const latency = { key: [], reading: [] };

/** Bars with names; rows keep their places unless the order changes clearly. */
class Bars {
  constructor(n, across = false) { Object.assign(this, { n, across, order: [], element: element("ol", { class: across ? "bars across" : "bars" }) }); }

  show(shares, label, colour) {
    if (this.across) this.order = [...shares.keys()];
    const found = shares.map((_, k) => k).sort((a, b) => shares[b] - shares[a]).slice(0, this.n);
    const rank = k => shares[k] + (this.order.includes(k) ? 0.02 : 0);
    const known = this.order.filter(k => k < shares.length);
    const chosen = [...new Set([...known, ...found])].sort((a, b) => rank(b) - rank(a)).slice(0, this.n);
    const before = k => { const at = known.indexOf(k); return at < 0 ? Infinity : at; };
    chosen.sort((a, b) => this.across ? a - b : Math.abs(shares[a] - shares[b]) > 0.04 ? shares[b] - shares[a] : before(a) - before(b));
    this.order = chosen;
    while (this.element.children.length > chosen.length) this.element.lastChild.remove();
    for (const [place, k] of chosen.entries()) {
      const row = this.element.children[place] ?? this.element.appendChild(element("li", {}, element("span", {}), element("span", { class: "bar" }, element("span")), element("span", { class: "share" })));
      row.children[0].textContent = label(k);
      Object.assign(row.children[1].firstChild.style, { width: `${100 * shares[k]}%`, background: colour(k, place) });
      row.children[2].textContent = percent(shares[k]);
    }
  }
}

/** The probabilities of one agent's goals over time. */
function chart(canvas, readings, agent, goals, at) {
  const scale = window.devicePixelRatio || 1, pen = canvas.getContext("2d");
  Object.assign(canvas, { width: Math.round(canvas.clientWidth * scale), height: Math.round(canvas.clientHeight * scale) });
  const last = Math.max(20, readings.length - 1), x = frame => 2 + frame / last * (canvas.width - 4), y = share => (1 - share) * (canvas.height - 6) + 3;
  for (const [place, goal] of [...goals.entries()].reverse()) {
    pen.beginPath();
    readings.forEach((reading, frame) => pen.lineTo(x(frame), y(reading.goals[agent][goal])));
    Object.assign(pen, { strokeStyle: PALETTE[place], lineWidth: (place ? 1.5 : 3) * scale });
    pen.stroke();
  }
  pen.fillStyle = "#1b1b1b";
  pen.fillRect(x(at) - scale / 2, 0, scale, canvas.height);
}

class Live {
  constructor(main) {
    this.reads = [];     // frame -> poses, as the model reads them
    this.readings = [];  // frame -> what was believed
    this.shownAt = [];   // frame -> when it had been shown
    this.looking = null; // a frame of the past
    this.state = "waiting";
    this.waiting = [];   // presses that no picture shows yet
    this.heard = 0;
    this.games = 0;
    this.canvas = element("canvas", { role: "img", tabindex: 0, width: 560, height: 560, "aria-label": "The game, seen from above" });
    this.view = new View(this.canvas);
    this.heading = element("h1", {}, "What does the model believe you want?");
    this.goal = element("p", { class: "told" }, "One moment \u2026");
    this.status = element("p", { class: "status", role: "status" });
    this.goButton = element("button", { type: "button", click: () => this.toggle() }, "Pause");
    this.slider = element("input", { type: "range", min: 0, max: 0, value: 0, "aria-label": "Frame", input: () => this.look(Number(this.slider.value)) });
    this.clock = element("span", { class: "share" }, "0.0 s");
    const button = (label, click) => element("button", { type: "button", click }, label);
    const pads = [["turn left", "\u21ba"], ["forward", "\u25b2"], ["turn right", "\u21bb"], ["grab", "grab"], ["left", "\u25c0"], ["backward", "\u25bc"], ["right", "\u25b6"]];
    this.pad = element("div", { class: "pad", role: "group", "aria-label": "Steer" }, ...pads.map(([key, sign]) => element("button", { type: "button", "aria-label": key,
      pointerdown: event => { event.preventDefault(); this.press(key, true); }, pointerup: () => this.press(key, false), pointercancel: () => this.press(key, false),
      pointerleave: () => this.press(key, false), contextmenu: event => event.preventDefault() }, sign)));
    const keys = element("p", { class: "small keys" }, ...HELP.flatMap(([key, arrow, does]) => [element("kbd", {}, key), arrow ? element("kbd", {}, arrow) : null, ` ${does}  `]));
    this.brief = element("p", { class: "brief" });
    const game = element("section", { class: "game", "aria-label": "The game" }, this.canvas, this.brief, this.status, this.pad);
    if (SECOND) { main.append(element("div", { class: "live" }, this.heading, this.goal, game)); this.heading.textContent = "The second player"; game.append(keys); return; }
    game.append(element("div", { class: "buttons" }, this.goButton, this.slider, this.clock),
      element("div", { class: "buttons" }, button("Start over", () => this.begin()), this.newScene = button("Another scene", () => this.begin({ new_scene: true })),
        element("a", { href: "/event.json", download: "live.json" }, "Save as event"), button("Make a film", () => this.send({ t: "film" }))), keys);
    this.lag = element("p", { class: "small" }, "The model wakes up, which takes some seconds. You can play meanwhile.");
    this.minds = element("div", { class: "minds" });
    this.why = element("p", { class: "why-text" });
    this.chart = element("canvas", { class: "chart", role: "img", "aria-label": "Probability of your likeliest goals over time; the lines have the colours of the bars" });
    this.films = element("div", {});
    this.setup = element("details", {}, element("summary", {}, "Who plays what"));
    this.whatIf = element("details", {}, element("summary", {}, "What if \u2026"));
    main.append(element("div", { class: "live" }, this.heading, this.goal, game, element("section", { "aria-label": "What the model believes" },
      this.minds, this.chart, element("h3", {}, "Why"), this.why, this.lag, this.setup, this.whatIf)));
    game.append(this.films);
  }

  start() {
    addEventListener("keydown", event => this.key(event, true));
    addEventListener("keyup", event => this.key(event, false));
    addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => { if (document.hidden) this.release(); });
    const draw = () => {
      this.view.draw();
      for (const press of this.waiting.filter(press => press.number <= this.heard)) latency.key.push(performance.now() - press.at);
      this.waiting = this.waiting.filter(press => press.number > this.heard);
      requestAnimationFrame(draw);
    };
    draw();
    this.connect();
  }

  connect(wait = 250) {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket/${SECOND ? 1 : 0}`);
    this.socket = socket;
    socket.onopen = () => { wait = 250; say(""); };
    socket.onmessage = event => { const message = JSON.parse(event.data); this.heed[message.t]?.call(this, message); };
    socket.onclose = event => {
      if (event.code === 4409) { say("The game goes on in another window. Reload this page to play here."); return; }
      say("The connection is lost; trying again.");
      setTimeout(() => this.connect(Math.min(2 * wait, 4000)), wait);
    };
  }

  send(message) { if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message)); }

  // --- keys -----------------------------------------------------------------------------------------

  key(event, down) {
    const key = KEYS[event.code];
    if (!key || event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.("select, input, summary, a")) return;
    if (event.code === "Space" && event.target.closest?.("button")) return;
    event.preventDefault(); // arrows and space would scroll
    if (!event.repeat) this.press(key, down);
  }

  press(key, down) {
    if (down && this.looking !== null) { this.status.textContent = "This is the past: press \u201cGo on\u201d first."; return; }
    this.send({ t: "key", key, down });
    if (!down) return;
    this.send({ t: "hurry" });
    if (this.state === "going") this.waiting.push({ number: Math.max(this.heard, this.waiting.at(-1)?.number ?? 0) + 1, at: performance.now() });
  }

  release() { this.waiting = []; this.send({ t: "release" }); }

  // --- the game -------------------------------------------------------------------------------------

  begin(changes = {}) { this.send({ t: "begin", wishes: { ...this.wishes, new_scene: false, ...changes } }); this.canvas.focus({ preventScroll: true }); }

  toggle() {
    if (this.state === "going") { this.send({ t: "pause" }); return; }
    const back = this.looking;
    this.looking = null;
    if (back !== null && back < this.reads.length - 1) {
      this.kept = back;
      this.send({ t: "back", frame: back });
      this.status.textContent = "Going back \u2026";
    } else this.send({ t: "go" });
    this.canvas.focus({ preventScroll: true });
  }

  /** Look at a frame as the model read it. */
  look(frame) {
    if (this.state === "going") this.send({ t: "pause" });
    this.looking = frame;
    this.picture(frame);
    if (this.readings[frame]) this.believe(frame);
    else this.send({ t: "look", frame }); // it was late for this one
    this.labels();
  }

  picture(frame) {
    const reading = this.readings[frame], past = { poses: this.reads[frame], held: reading?.held ?? [], sight: reading?.sights[this.scene.agent] };
    this.view.frames = [{ ...past, at: 0 }];
  }

  labels() {
    if (SECOND) return;
    const frame = this.looking ?? Math.max(0, this.reads.length - 1);
    Object.assign(this.slider, { max: Math.max(0, this.reads.length - 1), value: frame });
    this.slider.setAttribute("aria-valuetext", seconds(frame));
    this.clock.textContent = seconds(frame);
    this.goButton.textContent = this.state === "going" ? "Pause" : this.looking !== null && frame < this.reads.length - 1 ? "Go on from here" : "Go on";
  }

  heed = {
    ping() { this.send({ t: "pong" }); },
    elsewhere() {},
    nobody() { this.goal.textContent = "This game has no second player. The first player can choose one."; },
    setup(message) { this.choices = message; this.wishes = message.wishes; this.offer(); },
    scene(message) {
      this.scene = message;
      this.games++;
      this.view.begin(message);
      const kept = this.kept === undefined ? 0 : this.kept + 1;
      this.reads = [];
      this.readings.length = Math.min(this.readings.length, kept);
      this.kept = undefined;
      Object.assign(this, { looking: null, waiting: [], heard: 0, shownAt: [], lost: false });
      const who = SECOND ? null : this.choices.agents[message.agent];
      this.goal.replaceChildren(SECOND ? "Your agent has a ring. Your goal: " : `You steer ${who}, the one with a ring. Your goal: `, element("strong", {}, message.goal.replace("itself", "yourself")), SECOND ? "." : ". The model is not told: it reads only places and angles of the bodies.");
      if (!SECOND) { this.panel(); this.believe(this.readings.length - 1); }
    },
    frame(message) { this.heard = message.heard; if (this.looking === null) this.view.add(message); },
    read(message) {
      this.reads[message.frame] = message.poses;
      this.shownAt[message.frame] = performance.now();
      this.labels();
      this.behind();
    },
    reading(message) {
      const { frame } = message;
      this.readings[frame] = message;
      if (this.state === "going" && frame) latency.reading.push(performance.now() - this.shownAt[frame]);
      if (this.looking === frame) this.picture(frame);
      if (this.looking === null || this.looking === frame) this.believe(frame);
      this.behind();
    },
    waiting() { this.state = "waiting"; this.status.textContent = this.reads.length > 1 ? "Press a key to go on from here." : "Press a key to begin."; this.labels(); },
    going() { this.state = "going"; if (this.looking !== null) this.looking = null; this.status.textContent = ""; this.labels(); },
    paused(message) {
      this.state = "paused";
      this.labels();
      this.status.textContent = message.why === "reached" ? "You are there!" : "Paused. Move the slider to look back.";
      this.atEnd = message.why === "reached";
      this.tellEnd();
    },
    over() { this.state = "over"; this.status.textContent = "The time is up."; this.labels(); },
    refused(message) { this.status.textContent = message.text; },
    unread(message) { this.lost = true; this.lag.textContent = `The model cannot read on: ${message.text}`; },
    making(message) {
      const what = message.what === "film" ? "The film" : "The answer";
      this.films.prepend(element("section", { id: `film-${message.number}` }, element("p", { role: "status" }, `${what} is being made, which takes some seconds \u2026`)));
    },
    made(message) {
      const source = `/film/${message.number}.mp4`;
      document.getElementById(`film-${message.number}`)?.replaceChildren(...message.text.split("\n").map(line => element("p", {}, line)),
        Object.assign(element("video", { src: source, controls: true, playsinline: true, loop: true, "aria-label": "The film" }), { muted: true, autoplay: true }),
        element("p", {}, element("a", { href: source, download: "live.mp4" }, "Save the film")));
    },
    failed(message) { document.getElementById(`film-${message.number}`)?.replaceChildren(element("p", { role: "alert" }, message.text)); },
  };

  // --- what is believed -----------------------------------------------------------------------------

  word(agent, goal) { const name = this.choices.goals[goal] ?? goal; return this.mine(agent, this.choices.words[agent][name] ?? name); }

  mine(agent, words) { return agent === this.scene?.agent ? words.replace("itself", "yourself") : words; }

  /** Lay out the panel for the agents of this game. */
  panel() {
    const { agents } = this.choices, me = this.scene.agent;
    this.bars = agents.map(() => ({ goals: new Bars(LEADING), strengths: new Bars(4, true), sees: element("p", { class: "small" }) }));
    this.relations = new Map();
    this.between = element("div", {});
    const order = [...agents.keys()].sort((a, b) => (a !== me) - (b !== me));
    this.minds.replaceChildren(...order.map(agent => {
      const { goals, strengths, sees } = this.bars[agent];
      return element("div", {}, element("h2", {}, agent === me ? `You, ${agents[agent]}, want to` : `${agents[agent][0].toUpperCase()}${agents[agent].slice(1)} wants to`),
        goals.element, element("h3", {}, "Strength"), strengths.element, element("h3", {}, agent === me ? "You see" : "It sees"), sees);
    }), this.between);
  }

  believe(frame) {
    const reading = this.readings[frame];
    if (!reading || SECOND) return;
    const me = this.scene.agent;
    for (const [agent, { goals, strengths, sees }] of this.bars.entries()) {
      goals.show(reading.goals[agent], goal => this.word(agent, goal), (_, place) => agent === me ? PALETTE[place] : "#5f6b7a");
      strengths.show(reading.strengths[agent], level => `${this.choices.levels[level]} N`, () => "#5f6b7a");
      sees.textContent = this.sight(reading, agent);
    }
    for (const [pair, shares] of Object.entries(reading.relations)) {
      if (!this.relations.has(pair)) {
        const bars = new Bars(3, true);
        this.relations.set(pair, bars);
        const only = Object.keys(reading.relations).length === 1;
        this.between.append(element("h2", {}, only ? "You are to each other" : pair), bars.element);
      }
      this.relations.get(pair).show(shares, k => RELATIONS[k], k => RELATION_COLOURS[k]);
    }
    this.why.textContent = this.reason(reading.why);
    const [first] = this.bars[me].goals.order;
    this.brief.textContent = `The model: you want to ${this.word(me, first)}, ${percent(reading.goals[me][first])}.`;
    chart(this.chart, this.readings, me, this.bars[me].goals.order, frame);
    this.tellEnd();
  }

  /** What an agent sees, or saw, if the model is right. */
  sight(reading, agent) {
    const { entities } = this.choices, now = [], before = [], never = [];
    for (const [entity, last] of reading.seen[agent].entries()) {
      if (entity === agent) continue;
      if (last === null) never.push(entities[entity]);
      else if (last >= reading.frame) now.push(entities[entity]);
      else before.push(`${entities[entity]} ${seconds(reading.frame - last)} ago`);
    }
    const held = reading.held[agent] ?? -1;
    return [now.length ? `${now.join(", ")}.` : "nothing but the room.", before.length ? `Saw ${before.join(", ")}.` : "", never.length ? `Not yet seen: ${never.join(", ")}.` : "",
      held >= 0 ? `Holds ${entities[held]}.` : ""].filter(Boolean).join(" ");
  }

  reason(why) {
    if (!why) return "Nothing has happened yet: this is what the model believes before it sees you move.";
    const me = this.scene.agent, quoted = goal => `\u201c${this.word(me, goal)}\u201d`;
    const did = why.did ? `you ${why.did}` : "you moved";
    return `${quoted(why.goal)} rather than ${quoted(why.over)}: the last second made it ${times(why.last)}. `
      + `The frame that spoke most for it was at ${seconds(why.deciding)}: ${did}, which made it ${times(why.by)}. (Tempered: a frame counts 0.3.)`;
  }

  /** Once the player is there, what the model says of their goal. */
  tellEnd() {
    const frame = this.reads.length - 1, reading = this.readings[frame];
    if (!this.atEnd || !reading) return;
    const share = reading.goals[this.scene.agent][this.choices.goals.indexOf(this.scene.goals[this.scene.agent])];
    this.status.textContent = `You are there! The model gives your goal ${percent(share)}.`;
    this.atEnd = false;
  }

  behind() {
    if (SECOND || this.lost) return;
    const last = this.readings.length - 1, n = Math.max(0, this.reads.length - 1 - last);
    const told = (name, values) => values.length ? ` ${name} ${Math.round(quantile(values, 0.5))} ms (95 %: ${Math.round(quantile(values, 0.95))} ms).` : "";
    this.lag.textContent = (last < 0 ? "The model wakes up, which takes some seconds. You can play meanwhile." : n < 2 ? "Read up to now." : `Readings lag ${n} frames behind.`)
      + told("Key to picture", latency.key) + told("Picture to posterior", latency.reading);
  }

  // --- what can be chosen ---------------------------------------------------------------------------

  offer() {
    const { agents, goals, possible, partners, levels, draws, wishes, entities, keys } = this.choices;
    const select = (name, options, value, change) => element("select", { name, change: change ?? false }, ...options.map(([key, text]) => element("option", { value: key, selected: String(key) === String(value) }, text)));
    const named = (text, control) => { control.setAttribute("aria-label", text); return control; };
    const labelled = (text, control) => element("label", {}, text, control);
    const wanted = (agent, first) => [...first, ...possible[agent].map(goal => [goal, this.word(agent, goals.indexOf(goal))])];
    const goalOf = agent => select("goal", wanted(agent, [["", "draw one for me"]]), wishes.goal);
    const goal = element("span", {}, goalOf(wishes.agent));
    const agent = select("agent", agents.map((name, k) => [k, name]), wishes.agent, () => goal.replaceChildren(goalOf(Number(agent.value))));
    const newtons = levels.map(level => [level, `${level} N`]);
    const strengths = wishes.strengths.map((level, k) => select(`strength-${k}`, newtons, level));
    const partner = select("partner", partners.map(name => [name, PARTNERS[name]]), wishes.partner);
    const all = element("input", { type: "checkbox", checked: wishes.sees_all, change: () => { this.wishes.sees_all = all.checked; this.send({ t: "view", all: all.checked }); } });
    const form = element("form", { submit: event => {
      event.preventDefault();
      this.begin({ agent: Number(agent.value), goal: goal.firstChild.value, partner: partner.value, strengths: strengths.map(one => Number(one.value)), sees_all: all.checked });
    } }, labelled("I steer", agent), labelled("My goal:", goal), labelled("My strength:", strengths[0]),
    agents.length > 1 ? labelled("The others:", partner) : null, agents.length > 1 ? labelled("Their strength:", strengths[1]) : null,
    element("label", { class: "choice" }, all, "I see everything, not only what my agent sees"), element("button", { type: "submit" }, "Play this"));
    this.setup.replaceChildren(this.setup.firstChild, form, ...partners.includes("player") ? [element("p", { class: "small" }, "A second player opens ", element("a", { href: "/second", target: "_blank" }, `${location.origin}/second`), ".")] : []);
    this.newScene.hidden = !draws;

    const changes = new Map([["next", { label: "nothing changed: what comes next?", control: () => null, change: () => ({}) }]]);
    for (const [k, name] of agents.entries()) {
      changes.set(`goal-${k}`, { label: `${name} wanted to`, control: () => named("What they wanted", select("to", wanted(k, []), "")), change: value => ({ [`goal_${keys[k]}`]: value }) });
      changes.set(`strength-${k}`, { label: `${name} had a strength of`, control: () => named("Strength", select("of", newtons, "")), change: value => ({ [`strength_${keys[k]}`]: Number(value) }) });
    }
    for (const [k, name] of entities.entries()) changes.set(`remove-${k}`, { label: `there were no ${name.replace(/^the /, "")}`, control: () => null, change: () => ({ remove: this.choices.names[k] }) });
    const more = element("span", {});
    const kind = select("what", [...changes].map(([key, { label }]) => [key, label]), "next", () => more.replaceChildren(...[changes.get(kind.value).control()].filter(Boolean)));
    const ask = element("form", { submit: event => {
      event.preventDefault();
      if (this.state === "going") this.send({ t: "pause" });
      this.send({ t: "what if", frame: this.looking ?? this.reads.length - 1, change: changes.get(kind.value).change(more.firstChild?.value) });
    } }, labelled("From the frame on show, what if", kind), more, element("button", { type: "submit" }, "Simulate 9 s"));
    this.whatIf.replaceChildren(this.whatIf.firstChild, ask, element("p", { class: "small" }, "Four hypotheses are drawn from the posterior and simulated from there, as it is and with the change. The answer counts simulated time, a third of the time on show."));
  }
}

window.live = new Live(document.getElementById("live"));
window.live.latency = latency;
window.live.start();
