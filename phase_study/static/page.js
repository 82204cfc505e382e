/* A jsPsych plugin for every page of a study: a film on the left, questions on the right; or only text,
   with choices, or in several steps. What is on it comes from the server (phase_study/plan.py). */
"use strict";

/** A film with a button of its own: native controls would cover its lower quarter. */
class Film {
  constructor(source, note, moments = []) {
    this.moments = [...moments]; // seconds at which it still has to stop
    this.waiting = null;         // at which it has stopped, for an answer
    this.plays = 0;
    this.firstEnd = null;
    const begun = performance.now();
    this.video = element("video", { src: source, playsinline: true, disablepictureinpicture: true, tabindex: -1,
      "aria-label": "The animation", preload: "auto" });
    this.video.muted = true; // a sound track, even an empty one, would forbid it to begin by itself
    this.button = element("button", { type: "button", class: "jspsych-btn", click: () => this.toggle() }, "Play");
    this.status = element("span", { role: "status" });
    this.element = element("div", { class: "film" }, this.video, element("p", {}, this.button, this.status));
    const says = (label, text = "") => { this.button.textContent = label; this.status.textContent = text; };
    let fromTheStart = true; // not by the time of the film, which goes on until the event is heard
    this.video.addEventListener("play", () => { if (fromTheStart) this.plays++; fromTheStart = false; says("Pause"); watch(); });
    const stop = () => {
      if (this.waiting !== null || !(this.video.currentTime >= this.moments[0])) return;
      this.waiting = this.moments.shift();
      this.video.pause();
      this.video.currentTime = this.waiting; // a slow device has gone past it, maybe to the end
      this.button.disabled = true;
      says("Play", "The animation has stopped. Please answer by what you have seen so far.");
    };
    const watch = () => { stop(); if (!this.video.paused) requestAnimationFrame(watch); };
    this.video.addEventListener("timeupdate", stop); // a hidden page draws no frames
    this.video.addEventListener("pause", () => { if (this.waiting === null && !this.video.ended && !this.video.error) says("Play"); });
    this.video.addEventListener("ended", () => { if (this.waiting !== null) return; this.firstEnd ??= Math.round(performance.now() - begun); fromTheStart = true; says("Play again"); });
    this.video.addEventListener("error", () => {
      fromTheStart = true;
      note("video error", this.video.error?.code);
      says("Try again", "The animation cannot be shown. Please try again, or reload the page.");
    });
    this.refused = () => { note("autoplay refused"); says("Play", "Press the button to start the animation."); };
  }
  start() { this.video.play().catch(error => { if (error.name === "NotAllowedError") this.refused(); }); }
  goOn() { this.waiting = null; this.button.disabled = false; this.video.play().catch(() => {}); }
  toggle() {
    if (this.video.error) this.video.load();
    if (this.video.paused || this.video.ended) this.video.play().catch(() => {});
    else this.video.pause();
  }
}

/** A question: its element, what is answered (undefined: nothing yet). */
const QUESTIONS = {
  one: question => radios(question, row => element("div", { class: "row" }, ...row)),
  many: question => {
    const boxes = question.options.map(([value, label]) => {
      const box = element("input", { type: "checkbox", name: question.name, value });
      return [box, element("label", { class: "choice" }, box, label)];
    });
    return {
      element: fieldset(question, element("div", { class: "columns" }, ...boxes.map(([, label]) => label))),
      answer: () => { const on = boxes.filter(([box]) => box.checked).map(([box]) => box.value); return on.length ? on : undefined; },
    };
  },
  number: question => {
    const input = element("input", { type: "number", name: question.name, min: question.least, max: question.most, step: 1,
      id: `field-${question.name}` });
    const label = element("label", { for: input.id }, question.legend);
    return {
      element: element("p", { class: "field" }, label, input),
      answer: () => input.value === "" && !input.validity.badInput ? null : input.checkValidity() ? Number(input.value) : undefined,
    };
  },
  slider: question => {
    const slider = ranged(question.legend, question);
    return { element: fieldset(question, slider.element), answer: () => slider.moved() ? slider.value() : undefined };
  },
  sliders: question => {
    const all = question.options.map(([value, label]) => [value, ranged(label, question)]);
    return {
      element: fieldset(question, ...all.map(([, slider]) => slider.element)),
      answer: () => all.some(([, slider]) => slider.value() > 0) ? Object.fromEntries(all.map(([value, slider]) => [value, slider.value()])) : undefined,
    };
  },
  goals: question => {
    const words = new Map(question.options), rest = new Map(words);
    const radio = goal => { rest.delete(goal); return element("input", { type: "radio", name: question.name, value: goal, "aria-label": words.get(goal) }); };
    const tables = question.tables.map(({ heads, columns, rows }) => element("table", { class: columns.length > 4 && "many" },
      element("thead", {},
        element("tr", {}, element("td", { rowspan: 2 }, "to get \u2026"), ...heads.map(head => element("th", { colspan: columns.length, scope: "colgroup" }, head))),
        element("tr", {}, ...heads.flatMap(() => columns.map(([name, colour]) => element("th", { scope: "col" }, swatch(colour, name), name))))),
      element("tbody", {}, ...rows.map(([name, colour, goals]) => element("tr", {}, element("th", { scope: "row" }, swatch(colour), name),
        ...goals.map(goal => element("td", {}, goal && element("label", { class: "cell" }, radio(goal)))))))));
    const others = [...rest].map(([goal, words]) => element("label", { class: "choice" }, radio(goal), words.startsWith("get ") ? `to ${words}` : words));
    const made = fieldset(question, ...tables, others.length ? element("div", { class: "row" }, ...others) : null);
    return { element: made, answer: () => made.querySelector("input:checked")?.value };
  },
};

function fieldset(question, ...children) {
  return element("fieldset", { class: question.kind }, element("legend", {}, swatch(question.colour), question.legend), ...children);
}

/** A slider from 0 on, with its name and its number. */
function ranged(label, question) {
  let moved = false;
  const number = element("output", {}, "0");
  const input = element("input", { type: "range", min: 0, max: question.most, step: 1, value: 0, "aria-label": label,
    input: () => { moved = true; number.textContent = input.value; } });
  input.value = 0;
  return { element: element("label", { class: "slider" }, element("span", {}, label), input, number), moved: () => moved, value: () => Number(input.value) };
}

/** A little square of a colour, or of one that the style sheet knows by name. */
function swatch(colour, name) {
  const made = element("span", { class: colour || !name ? "swatch" : `swatch ${name}` });
  if (colour) made.style.background = colour;
  return colour || name ? made : null;
}

function radios(question, layout) {
  const inputs = question.options.map(([value, label]) => {
    const input = element("input", { type: "radio", name: question.name });
    return [input, value, element("label", { class: "choice" }, input, label)];
  });
  return {
    element: fieldset(question, layout(inputs.map(([, , label]) => label))),
    answer: () => { const on = inputs.find(([input]) => input.checked); return on ? on[1] : question.optional ? null : undefined; },
  };
}

var jsPsychPage = (function (jspsych) {
  const type = jspsych.ParameterType;
  class Page {
    constructor(jsPsych) { this.jsPsych = jsPsych; }

    trial(display, trial) {
      const page = trial.description, begun = performance.now(), shown = Date.now();
      const elapsed = () => Math.round(performance.now() - begun);
      const heading = element("h1", { tabindex: -1 }, page.heading);
      const why = element("p", { class: "why", role: "alert" });
      let film = null;
      const finish = answers => {
        film?.video.pause();
        this.jsPsych.finishTrial({ answers, rt: elapsed(), shown, plays: film?.plays ?? null, first_end: film?.firstEnd ?? null });
      };
      const show = (...children) => {
        display.replaceChildren(element("article", { class: page.wide ? "wide" : "narrow" }, heading, ...children));
        heading.focus({ preventScroll: true });
        window.scrollTo(0, 0);
        film?.start();
      };
      if (page.steps) { this.steps(page, trial, show, finish, elapsed, shown => { film = shown; }); return; }
      if (page.video) film = new Film(trial.source(page.video), trial.note, page.moments);
      const stops = [];
      const text = element("div", { class: "text", html: page.html });
      if (page.choices) {
        show(text, element("p", { class: "buttons" }, ...page.choices.map(([value, label]) =>
          element("button", { type: "button", class: "jspsych-btn", click: () => finish({ agree: value }) }, label))));
        return;
      }
      const questions = page.questions.map(question => [question.name, QUESTIONS[question.kind](question)]);
      const submit = event => {
        event.preventDefault();
        for (const [, question] of questions) question.element.classList.remove("missing");
        if (film && film.firstEnd === null && film.waiting === null) { why.textContent = "Please watch the animation to its end first."; film.button.focus(); return; }
        if (screen.width < page.min_width || film?.video.videoWidth === 0) {
          trial.note("device refused", screen.width);
          show(element("div", { class: "text", role: "alert", html: page.refused }));
          return;
        }
        const answers = Object.fromEntries(questions.map(([name, question]) => [name, question.answer()]));
        const missing = questions.filter(([name]) => answers[name] === undefined).map(([, question]) => question.element);
        if (missing.length) {
          why.textContent = missing.length > 1 ? `${missing.length} questions are still open.` : "One question is still open.";
          for (const one of missing) one.classList.add("missing");
          missing[0].querySelector("input").focus();
          return;
        }
        why.textContent = "";
        if (film && film.waiting !== null) {
          stops.push({ at: film.waiting, rt: elapsed(), ...answers });
          film.goOn();
          return;
        }
        finish(page.moments?.length ? { ...answers, moments: stops } : answers);
      };
      const form = element("form", { submit, novalidate: true }, ...questions.map(([, question]) => question.element),
        element("p", { class: "buttons" }, element("button", { class: "jspsych-btn" }, page.button), why));
      if (page.wide) show(element("div", { class: "columns-2" }, element("div", {}, film.element, text), form));
      else show(text, film?.element, form);
    }

    /** Pages of text, to and fro. */
    steps(page, trial, show, finish, elapsed, keep) {
      const views = [];
      let since = 0;
      const go = index => {
        if (index === page.steps.length) { views.push(elapsed() - since); finish({ views }); return; }
        if (views.length || since) views.push(elapsed() - since);
        since = elapsed();
        const step = page.steps[index];
        const film = step.video ? new Film(trial.source(step.video), trial.note) : null;
        keep(film);
        const button = (label, to) => element("button", { type: "button", class: "jspsych-btn", click: () => go(to) }, label);
        show(index === 0 && page.html ? element("div", { class: "text notice", html: page.html }) : null,
          element("div", { class: "text", html: step.html }), film?.element,
          element("p", { class: "buttons" }, index ? button("Back", index - 1) : null, button("Next", index + 1),
            element("span", {}, `${index + 1} of ${page.steps.length}`)));
      };
      go(0);
    }
  }
  Page.info = {
    name: "study-page", version: "1.0.0",
    parameters: { description: { type: type.COMPLEX, default: undefined }, source: { type: type.FUNCTION, default: url => url },
      note: { type: type.FUNCTION, default: () => {} } },
    data: { answers: { type: type.COMPLEX }, rt: { type: type.INT }, shown: { type: type.FLOAT }, plays: { type: type.INT },
      first_end: { type: type.INT } },
  };
  return Page;
})(jsPsychModule);
