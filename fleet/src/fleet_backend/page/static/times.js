// Shows moments in the time of the reader's machine instead of UTC, while a button says so. Without this script all are UTC.
"use strict";
(() => {
  const button = document.getElementById("times");
  const shown = document.getElementById("live") || document.querySelector("main");
  if (!button || !shown) return;
  let isLocal = false;
  try { isLocal = localStorage.getItem("times") === "local"; } catch { /* a browser that keeps nothing */ }
  const two = (number) => String(number).padStart(2, "0");
  const local = (at, length) => `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())} `
    .concat(`${two(at.getHours())}:${two(at.getMinutes())}:${two(at.getSeconds())}`).slice(0, length);
  const show = () => {
    for (const one of shown.querySelectorAll('time[datetime*="T"]')) {
      one.dataset.utc ??= one.textContent;
      one.textContent = isLocal ? local(new Date(one.dateTime), one.dataset.utc.length) : one.dataset.utc;
    }
    for (const one of shown.querySelectorAll("thead th, thead th a")) {
      if (!one.children.length) one.textContent = one.textContent.replace(/\((UTC|local)\)/, isLocal ? "(local)" : "(UTC)");
    }
    for (const one of shown.querySelectorAll("[data-name]")) {
      one.dataset.name = one.dataset.name.replace(/\((UTC|local)\)/, isLocal ? "(local)" : "(UTC)");
    }
    button.setAttribute("aria-pressed", String(isLocal));
  };
  button.hidden = false;
  button.addEventListener("click", () => {
    isLocal = !isLocal;
    try { localStorage.setItem("times", isLocal ? "local" : "UTC"); } catch { /* likewise */ }
    show();
  });
  new MutationObserver(show).observe(shown, { childList: true });
  show();
})();
