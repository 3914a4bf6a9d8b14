// Renews what is shown once the server has something new. Without this script a page stays as it was.
"use strict";
(() => {
  const PERIOD_MS = 5000;
  const shown = document.getElementById("live");
  const said = document.getElementById("said");
  if (!shown || !shown.dataset.mark) return;
  const say = (text) => { if (said.textContent !== text) said.textContent = text; };

  const renew = async () => {
    try {
      const answer = await fetch(location.href, { headers: { accept: "text/html", "if-none-match": `"${shown.dataset.mark}"` } });
      if (answer.ok) show(await answer.text());
      else if (answer.status !== 304) throw new Error(answer.status);
      else if (!said.textContent.startsWith("Renewed")) say("Renews itself.");
    } catch {
      say("The server does not answer; this is what was read last.");
    }
    setTimeout(renew, PERIOD_MS);
  };

  const show = (text) => {
    const fresh = new DOMParser().parseFromString(text, "text/html").getElementById("live");
    const focused = shown.contains(document.activeElement) ? document.activeElement : null;
    if (!fresh || (focused && focused.matches("input, textarea, select"))) return;
    const href = focused && focused.getAttribute("href");
    const scrolled = [...shown.querySelectorAll(".scroll")].map((table) => table.scrollLeft);
    shown.replaceChildren(...fresh.childNodes);
    shown.querySelectorAll(".scroll").forEach((table, place) => { table.scrollLeft = scrolled[place] || 0; });
    if (href) shown.querySelector(`a[href="${CSS.escape(href)}"]`)?.focus({ preventScroll: true });
    shown.dataset.mark = fresh.dataset.mark;
    say(`Renewed at ${new Date().toLocaleTimeString()}`);
  };

  renew();
})();
