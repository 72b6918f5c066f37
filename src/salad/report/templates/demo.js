"use strict";
(() => {
  const root = document.documentElement;
  const all = (selector) => [...document.querySelectorAll(selector)];
  const map = document.querySelector(".map");
  const items = all("[data-n]");
  const chosen = { condition: "", verdict: "" };
  let picked = null; // the query that stays lit when the pointer leaves
  root.classList.add("js");

  // A query is lit on the map and in the list together.
  const light = (n) => {
    items.forEach((item) => item.classList.toggle("lit", item.dataset.n === n));
    map.classList.toggle("focused", n !== null);
  };
  const pick = (n) => {
    picked = n;
    light(n);
  };
  items.forEach((item) => {
    const n = item.dataset.n;
    item.addEventListener("pointerenter", (event) => event.pointerType === "mouse" && light(n));
    item.addEventListener("pointerleave", () => light(picked));
    item.addEventListener("focusin", () => light(n));
    item.addEventListener("focusout", () => light(picked));
    item.addEventListener("click", () => pick(n));
  });
  map.addEventListener("click", (event) => event.target.closest("[data-n]") || pick(null));
  document.addEventListener("keydown", (event) => event.key === "Escape" && pick(null));

  const show = () => {
    let shown = 0;
    items.forEach((item) => {
      const fits = Object.entries(chosen).every(([key, value]) => !value || item.dataset[key] === value);
      item.classList.toggle("out", !fits);
      shown += fits && item.matches(".strip");
    });
    const count = all(".strip").length;
    document.querySelector(".status").textContent =
      shown === count ? `${count} shown` : `${shown} of ${count} shown`;
  };
  all(".chip").forEach((chip) => {
    const group = "condition" in chip.dataset ? "condition" : "verdict";
    chip.addEventListener("click", () => {
      const value = chip.dataset[group];
      chosen[group] = chosen[group] === value ? "" : value; // a second press lets go
      all(`.chip[data-${group}]`).forEach((other) =>
        other.setAttribute("aria-pressed", String(other.dataset[group] === chosen[group])));
      pick(null);
      show();
    });
  });
  show();
})();
