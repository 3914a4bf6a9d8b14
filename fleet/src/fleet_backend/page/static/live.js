// Renews what is shown when the server says that something is new. Without this script a page stays as it was.
"use strict";
(() => {
  const shown = document.getElementById("live");
  const said = document.getElementById("said");
  if (!shown || shown.dataset.follows === undefined || !window.EventSource) return;
  const words = new URLSearchParams({ number: shown.dataset.number });
  if (shown.dataset.follows) words.set("vehicle", shown.dataset.follows);
  let isAsking = false;
  let isAskedAgain = false;

  const renew = async () => {
    if (isAsking) { isAskedAgain = true; return; }
    isAsking = true;
    try {
      const answer = await fetch(location.href, { headers: { accept: "text/html" } });
      if (!answer.ok) return;
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      const fresh = page.getElementById("live");
      if (!fresh) return;
      const focused = shown.contains(document.activeElement) ? document.activeElement : null;
      if (focused && focused.matches("input, textarea, select")) return;
      const href = focused && focused.getAttribute("href");
      const scrolled = [...shown.querySelectorAll(".scroll")].map((one) => one.scrollLeft);
      shown.replaceChildren(...fresh.childNodes);
      shown.querySelectorAll(".scroll").forEach((one, place) => { one.scrollLeft = scrolled[place] || 0; });
      if (href) shown.querySelector(`a[href="${CSS.escape(href)}"]`)?.focus({ preventScroll: true });
      said.textContent = `Renewed at ${new Date().toLocaleTimeString()}`;
    } catch {
      said.textContent = "The server does not answer; this is what was read last.";
    } finally {
      isAsking = false;
      if (isAskedAgain) { isAskedAgain = false; renew(); }
    }
  };

  const source = new EventSource(`/events?${words}`);
  source.addEventListener("news", renew);
  source.addEventListener("error", () => { said.textContent = "Waiting for the server; this is what was read last."; });
  source.addEventListener("open", () => { said.textContent = "Renews itself."; });
})();
