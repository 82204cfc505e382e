"use strict";
(() => {
  const list = document.getElementById("videos");
  const form = document.getElementById("filters");
  if (!list || !form) return;
  const items = [...list.children];
  const [scenario, outcome, order] = ["scenario", "outcome", "order"].map((n) => form.elements[n]);
  const places = new Map(items.map((item, place) => [item, place]));
  const keys = {
    file: (item) => places.get(item),
    surprise: (item) => Number(item.dataset.belief || 2),
    name: (item) => item.dataset.name,
  };
  const apply = () => {
    const key = keys[order.value];
    const before = (a, b) => (key(a) < key(b) ? -1 : key(a) > key(b) ? 1 : places.get(a) - places.get(b));
    let shown = 0;
    for (const item of [...items].sort(before)) {
      item.hidden = !(
        (!scenario || scenario.value === "" || item.dataset.scenario === scenario.value) &&
        (outcome.value === "" || item.dataset.outcome === outcome.value)
      );
      shown += item.hidden ? 0 : 1;
      list.append(item);
    }
    form.elements.count.value = `${shown} of ${items.length} videos`;
  };
  form.hidden = false;
  form.addEventListener("input", apply);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.elements.all.addEventListener("click", () => {
    const closed = items.some((item) => !item.hidden && !item.open);
    for (const item of items) if (!item.hidden) item.open = closed;
  });
  apply();
})();
