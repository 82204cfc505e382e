/* A jsPsych plugin in which somebody steers an agent: practice, the waiting room, and the sessions. The
   server has the world and the clock (phase_study/play.py); what it does not send is not seen. */
"use strict";

var jsPsychPlay = (function (jspsych) {
  const type = jspsych.ParameterType;
  const AGENTS = ["red agent", "green agent"];
  const OUTCOMES = { goals: "Both goals are reached!", time: "The time is up.", left: "The other player has left.",
    stopped: "The session was broken off." };
  const UNKNOWN = 4401, ELSEWHERE = 4409;

  /** "Get blue item to red lm" in words, for whoever is told. */
  function words(goal) {
    const [, entity, way, landmark] = /^Get (.+) (to|away from) (\w+) lm$/.exec(goal) ?? [];
    return entity ? `get the ${entity} ${way} the ${landmark} landmark` : goal.replace(/(to|from) (?=\w+ agent)/, "$1 the ");
  }

  class Play {
    constructor(jsPsych) { this.jsPsych = jsPsych; }

    trial(display, trial) {
      this.over = false;
      this.outcome = "";
      this.playing = false;
      this.canvas = element("canvas", { role: "img", tabindex: 0, width: 560, height: 560 });
      this.view = new View(this.canvas);
      this.heading = element("h1", { tabindex: -1 }, trial.description.heading);
      this.goals = element("div", { class: "text" });
      this.time = element("p", { class: "time" });
      this.status = element("p", { role: "status", class: "status" });
      this.alert = element("p", { role: "alert", class: "why" });
      this.button = element("button", { type: "button", class: "jspsych-btn", hidden: true, click: () => this.ready() });
      const help = element("table", {}, element("caption", {}, "Keys"), element("tbody", {}, ...HELP.map(([key, arrow, does]) =>
        element("tr", {}, element("td", {}, element("kbd", { "data-key": key }, key), arrow ? " or " : null, arrow ? element("kbd", {}, arrow) : null),
          element("td", {}, does)))));
      display.replaceChildren(element("article", { class: "wide play" }, this.canvas, element("div", {}, this.heading, this.goals,
        this.status, this.alert, element("p", { class: "buttons" }, this.button), this.time, help)));
      this.printed(help);
      this.heading.focus({ preventScroll: true });
      this.listeners = new AbortController();
      const listen = (target, what, heed) => target.addEventListener(what, heed, { signal: this.listeners.signal });
      listen(window, "keydown", event => this.key(event, true));
      listen(window, "keyup", event => this.key(event, false));
      listen(window, "blur", () => this.send({ t: "release" }));
      listen(document, "visibilitychange", () => {
        if (document.hidden) this.send({ t: "release" });
        else if (this.title) { document.title = this.title; this.title = null; }
      });
      const draw = () => { if (this.over) return; this.view.draw(); this.clock(); requestAnimationFrame(draw); };
      draw();
      this.connect();
    }

    /** The letters that are printed where ours are, on other keyboards. */
    async printed(help) {
      const map = await navigator.keyboard?.getLayoutMap?.().catch(() => null);
      for (const cell of help.querySelectorAll("[data-key]")) {
        const letter = map?.get(`Key${cell.dataset.key}`);
        if (letter) cell.textContent = letter.toUpperCase();
      }
    }

    // --- the connection -------------------------------------------------------------------------

    connect(wait = 250) {
      const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/play/socket`);
      this.socket = socket;
      socket.onopen = () => { wait = 250; this.alert.textContent = ""; };
      socket.onmessage = event => { const message = JSON.parse(event.data); this.heed[message.t]?.call(this, message); };
      socket.onclose = event => {
        if (this.over || socket !== this.socket) return;
        if (event.code === UNKNOWN) { this.finish(); return; }
        if (event.code === ELSEWHERE) { this.ask("The game goes on in another window.", "Play here", () => location.reload()); return; }
        this.alert.textContent = "The connection is lost; trying again. The game goes on meanwhile.";
        setTimeout(() => this.connect(Math.min(2 * wait, 4000)), wait);
      };
    }

    send(message) { if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message)); }

    key(event, down) {
      const key = KEYS[event.code];
      if (!key || !this.playing || event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.target.closest?.("button, a") && event.code === "Space") return;
      event.preventDefault(); // arrows and space would scroll
      if (!event.repeat) this.send({ t: "key", key, down });
    }

    // --- what the server says -------------------------------------------------------------------

    heed = {
      ping() { this.send({ t: "pong" }); },
      frame(message) { this.left = message.left; this.view.add(message); },
      wait(message) {
        this.playing = false;
        this.canvas.hidden = true;
        this.heading.textContent = "Looking for another player";
        this.goals.replaceChildren(element("p", {}, "Please keep this page open; it begins by itself."),
          element("p", {}, message.computer ? "If nobody comes in time, you play with the computer." : "If nobody comes in time, the study ends, and you are thanked for waiting."));
        this.until = performance.now() + 1000 * message.left;
        this.ask("", "");
        this.view.begin(null);
      },
      full() { this.ask("One moment, please \u2026", ""); },
      scene(message) {
        this.view.begin(message);
        this.canvas.hidden = false;
        this.until = null;
        this.left = null;
        this.practice = message.practice;
        this.playing = Boolean(this.practice);
        this.partner = message.partner;
        const mine = AGENTS[message.agent], other = AGENTS[1 - message.agent];
        this.canvas.setAttribute("aria-label", `What the ${mine} sees, seen from above. You steer the ${mine}, which has a ring around it.`);
        if (this.practice) {
          this.heading.textContent = "Practice";
          this.tasks = this.practice.map(task => element("li", {}, task));
          this.goals.replaceChildren(element("p", {}, `You steer the ${mine}, the one with a ring. Bright is what it sees. Please do this:`), element("ol", {}, ...this.tasks));
          this.ask("", "I am ready", () => this.send({ t: "ready" }), true);
          return;
        }
        this.heading.textContent = `Session ${message.session} of ${message.of}`;
        if (document.hidden) { this.title ??= document.title; document.title = "It begins! Please come back"; }
        const [own, theirs] = [message.goals[message.agent], message.goals[1 - message.agent]].map(words);
        this.goals.replaceChildren(
          element("p", {}, "You steer the ", element("strong", {}, mine), `, the one with a ring. The ${other} is steered by ${message.partner === "computer" ? "the computer" : "another person"}.`),
          element("p", {}, "Your goal: ", element("strong", {}, own), "."), element("p", {}, `Goal of the ${other}: `, element("strong", {}, theirs), "."),
          element("p", {}, message.ends_by_goals ? "It ends when both goals are reached and stay so for a moment, or when the time is up." : "It ends when the time is up."));
        this.agent = message.agent;
        const begin = () => this.ask(OUTCOMES[message.last] ? `${OUTCOMES[message.last]} Next session:` : "", "I am ready", () => this.send({ t: "ready" }));
        this.ask(OUTCOMES[message.last] ?? "", "");
        clearTimeout(this.pause);
        this.pause = setTimeout(begin, message.last ? 1500 : 0); // space may still be pressed from the session before
      },
      tasks(message) {
        this.tasks.forEach((task, k) => {
          task.classList.toggle("done", k < message.done);
          task.textContent = this.practice[k] + (k < message.done ? " \u2713 done" : "");
        });
        const all = message.done === this.practice.length;
        this.status.textContent = all ? "All done. Go on playing as long as you like." : message.done ? `${message.done} of ${this.practice.length} done` : "";
        this.button.disabled = !all;
      },
      ready(message) {
        if (message.players[this.agent]) clearTimeout(this.pause);
        if (!message.players[this.agent] || this.playing) return;
        this.ask(message.players[1 - this.agent] ? "" : "Waiting for the other player \u2026", "");
      },
      count(message) { clearTimeout(this.pause); this.ask("It begins \u2026", ""); this.view.big = String(message.left); },
      begun() { this.ask("", ""); this.view.big = ""; this.playing = true; this.canvas.focus({ preventScroll: true }); },
      end(message) { this.playing = false; this.outcome = OUTCOMES[message.outcome] ?? ""; this.view.big = ""; this.ask(this.outcome, ""); },
      error(message) { this.alert.textContent = `${message.text}. Please wait, or reload the page.`; },
      elsewhere() {}, // the socket is closed with a code
      go() { setTimeout(() => this.finish(), this.outcome ? 2500 : 0); },
    };

    /** Say something, and offer a button; "" for none. */
    ask(text, label, pressed = () => {}, disabled = false) {
      this.status.textContent = text;
      const had = document.activeElement === this.button;
      Object.assign(this.button, { textContent: label, hidden: !label, disabled });
      this.ready = pressed;
      if (label && !disabled) this.button.focus();
      else if (had) this.heading.focus({ preventScroll: true });
    }

    clock() {
      const seconds = this.until ? (this.until - performance.now()) / 1000 : this.playing && !this.practice ? this.left : null;
      const text = seconds == null ? "" : `${this.until ? "Waiting for up to" : "Time left:"} ${Math.max(0, Math.ceil(seconds))} s`;
      if (this.time.textContent !== text) this.time.textContent = text;
    }

    finish() {
      if (this.over) return;
      this.over = true;
      this.listeners.abort();
      this.socket.close();
      this.jsPsych.finishTrial({});
    }
  }
  Play.info = {
    name: "study-play", version: "1.0.0",
    parameters: { description: { type: type.COMPLEX, default: undefined }, source: { type: type.FUNCTION, default: url => url },
      note: { type: type.FUNCTION, default: () => {} } },
    data: {},
  };
  return Play;
})(jsPsychModule);
