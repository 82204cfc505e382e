/* The way through a study. The server owns it: this script asks what comes next, shows it, and keeps
   every answer in the browser until the server has confirmed it. */
"use strict";

const main = document.getElementById("study"), message = document.getElementById("message");
const bar = document.getElementById("progress");
const sleep = ms => new Promise(wake => { setTimeout(wake, ms); addEventListener("online", wake, { once: true }); });
const tell = text => { if (message.textContent !== text) message.textContent = text; };
const LOST = "There is no connection. Your answers are kept on this computer and sent as soon as it is back; please leave this page open.";

let participant = null;  // whose answers these are
let current = null;      // the page that is shown, as "trial-3-1"
let shownAt = 0;
let behind = false;      // another tab was faster
let abort = () => {};

async function request(path, body) {
  const options = body === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const reply = await fetch(path, { cache: "no-store", ...options });
  const found = await reply.json().catch(() => ({}));
  return { ok: reply.ok, status: reply.status, found };
}

/** Ask until there is an answer; 4xx is final. */
async function insist(path, body) {
  for (let wait = 500; ; wait = Math.min(2 * wait, 8000)) {
    try {
      const reply = await request(path, body);
      if (reply.status < 500 && reply.status !== 429) { tell(reply.ok ? "" : reply.found.error ?? `error ${reply.status}`); return reply; }
      tell(reply.status === 503 ? `One moment: ${reply.found.error ?? "the server is busy"}.` : "The server has a problem; trying again.");
    } catch { tell(LOST); }
    await sleep(wait);
  }
}

/** Answers that are not confirmed, in the order in which they were given. */
const unsent = {
  memory: new Map(), // where the browser keeps nothing
  prefix: () => `answer/${participant}/`,
  all() {
    const found = new Map([...this.memory].filter(([key]) => key.startsWith(this.prefix())));
    try {
      for (const key of Object.keys(localStorage)) if (key.startsWith(this.prefix())) found.set(key, JSON.parse(localStorage.getItem(key)));
    } catch { /* private browsing */ }
    return [...found].sort(([, one], [, other]) => one.shown_ms - other.shown_ms);
  },
  add(answer) {
    const key = `${this.prefix()}${answer.page}/${answer.attempt}`;
    try { localStorage.setItem(key, JSON.stringify(answer)); } catch { this.memory.set(key, answer); }
  },
  drop(key) { this.memory.delete(key); try { localStorage.removeItem(key); } catch { /* as above */ } },
};

let pumping = null;
/** Send what is unsent; the promise is kept once nothing is. */
function pump() {
  pumping ??= (async () => {
    for (let left = unsent.all(), failures = 0; left.length; left = unsent.all()) {
      const [key, answer] = left[0];
      let reply = null;
      try { reply = await request("/api/answer", answer); } catch { /* no network */ }
      if (reply === null || reply.status >= 500 || reply.status === 429) {
        if (reply?.status !== 429) tell(reply ? `Not saved yet: ${reply.found.error ?? "the server has a problem"}. Trying again.` : LOST);
        await sleep(Math.min(500 * 2 ** failures++, 8000));
        continue;
      }
      unsent.drop(key);
      if (failures) note("retry", failures);
      failures = 0;
      tell(reply.ok ? "" : `An answer was not accepted: ${reply.found.error ?? reply.status}`);
      if (current !== null && unsent.all().length === 0 && (!reply.ok || reply.found.next !== current)) { behind = true; abort(); }
    }
  })().finally(() => { pumping = null; });
  return pumping;
}

function note(what, detail = null) {
  if (participant) request("/api/note", { what, page: current, detail }).catch(() => {});
}
document.addEventListener("visibilitychange", () => { if (document.hidden && current) note("hidden", Date.now() - shownAt); });
addEventListener("blur", () => { if (current) note("blur", Date.now() - shownAt); });
addEventListener("beforeunload", event => { if (participant && unsent.all().length) event.preventDefault(); });

const films = new Map(); // address -> the film, kept here so that a lost connection does no harm
async function load(addresses) {
  const missing = addresses.filter(address => !films.has(address));
  for (const [done, address] of missing.entries()) {
    if (missing.length > 1) main.replaceChildren(element("p", { class: "narrow", role: "status" }, `Loading the animations: ${done} of ${missing.length}`));
    for (let wait = 500; !films.has(address); wait = Math.min(2 * wait, 8000)) {
      try {
        const reply = await fetch(address);
        if (!reply.ok) throw new Error(reply.status);
        films.set(address, URL.createObjectURL(await reply.blob()));
        tell("");
      } catch { tell("An animation could not be loaded; trying again."); await sleep(wait); }
    }
  }
}

/** Show pages one after another; what they are answered goes to the server meanwhile. */
async function run(state) {
  let pages = state.pages, done = state.done;
  const played = pages.findIndex(page => page.by_server);
  if (played >= 0) pages = pages.slice(0, Math.max(1, played));
  await load(pages.flatMap(page => [page.video, ...(page.steps ?? []).map(step => step.video)]).filter(Boolean));
  main.replaceChildren(); // jsPsych would leave there what is said while answers are saved
  const jsPsych = initJsPsych({ display_element: main });
  window.jsPsych = jsPsych;
  abort = () => jsPsych.abortExperiment();
  const timeline = pages.map(page => ({
    type: page.by_server ? jsPsychPlay : jsPsychPage,
    description: page,
    source: address => films.get(address) ?? address,
    note,
    on_start: () => { current = `${page.page}-${page.attempt}`; shownAt = Date.now(); bar.value = done; },
    on_finish: data => { // returns nothing: jsPsych would wait for a promise
      if (behind) return;
      current = null;
      done++;
      if (page.by_server) return;
      unsent.add({ participant, page: page.page, attempt: page.attempt, answers: data.answers, rt_ms: data.rt,
        shown_ms: data.shown, plays: data.plays, first_end_ms: data.first_end });
      pump();
    },
  }));
  bar.max = state.total;
  bar.hidden = false;
  main.replaceChildren(); // jsPsych adds to what is there
  await jsPsych.run(timeline);
  current = null;
  behind = false;
  if (unsent.all().length) main.replaceChildren(element("p", { class: "narrow", role: "status" }, "Your answers are being saved \u2026"));
  await pump();
}

function end(state) {
  bar.hidden = true;
  document.title = state.title;
  const heading = element("h1", { tabindex: -1 }, state.title);
  main.replaceChildren(element("article", { class: "narrow" }, heading, element("div", { class: "text", html: state.html }),
    state.code ? element("p", {}, "Your completion code: ", element("strong", { id: "code" }, state.code)) : null,
    state.return_url ? element("p", {}, element("a", { href: state.return_url }, "Back to where you came from")) : null));
  heading.focus();
}

(async () => {
  for (let first = true; ; first = false) {
    let { ok, found: state } = await insist("/api/state");
    if (!ok) return;
    if (state.status === "new") {
      const person = state.repeats ? new URLSearchParams(location.search).get(state.repeats) ?? "" : "";
      const entered = await insist("/api/enter", { person });
      if (!entered.ok) return;
      if (entered.found.status === "over") { end(entered.found); return; }
      ({ ok, found: state } = await insist("/api/state"));
      if (!ok) return;
      if (state.status === "new") { tell("This study needs cookies. Please allow them for this page, and reload it."); return; }
    }
    if (location.search) history.replaceState(null, "", location.pathname); // a platform's id
    if (state.status === "over") { end(state); return; }
    document.title = state.title;
    participant = state.participant;
    if (first && state.done) note("resume", state.done);
    if (unsent.all().length) { await pump(); continue; } // of before a reload
    await run(state);
  }
})();
