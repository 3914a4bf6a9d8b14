// Draws the fan chart over its picture: what is under the pointer is told, a click leads to the event. Without it the picture stays.
"use strict";
(() => {
  const colour = (name) => getComputedStyle(document.body).getPropertyValue(`--${name}`).trim();
  const paths = { spanGaps: false, points: { show: false } };
  const LEAST_PX = 280;
  let chart = null;

  const seriesOf = (told) => told.pasts.flatMap((past, place) => {
    const stroke = colour(`clutch${past.clutch}`);
    const edge = { ...paths, label: "", stroke: "transparent" };
    const line = { ...paths, label: past.title, stroke, width: place ? 1.5 : 2.6 };
    return place ? [line] : [line, edge, edge];
  });

  const draw = () => {
    const data = document.getElementById("fan");
    const picture = document.querySelector("figure.fan svg.plot");
    if (!data || !picture || !window.uPlot) return;
    if (chart) chart.destroy();
    document.querySelectorAll(".chart").forEach((one) => one.remove());
    const told = JSON.parse(data.textContent);
    const place = document.createElement("div");
    place.className = "chart";
    place.setAttribute("aria-hidden", "true"); // the picture below it and the table of events say the same
    picture.before(place);
    const said = document.createElement("p");
    const [first] = told.pasts;
    const tables = told.pasts.map((past, number) => (number ? [past.x, past.left] : [past.x, past.left, past.low, past.high]));
    const ahead = told.ahead.length ? [[told.ahead, ...told.quantiles]] : [];
    const all = uPlot.join([...tables, ...ahead]);
    const edge = { ...paths, stroke: "transparent" };
    const middle = { ...paths, stroke: colour("ink"), dash: [5, 3], width: 1.5 };
    const series = [{}, ...seriesOf(told), ...(ahead.length ? [edge, middle, edge] : [])];
    const bands = [{ series: [3, 2], fill: `${colour(`clutch${first.clutch}`)}33` }];
    if (ahead.length) bands.push({ series: [series.length - 1, series.length - 3], fill: `${colour("ink")}33` });
    const axis = { stroke: colour("muted"), grid: { stroke: colour("rule"), width: 1 }, ticks: { show: false } };

    const mark = (plot) => {
      const { ctx, bbox } = plot;
      const across = (from, to, name) => {
        const [top, bottom] = [plot.valToPos(to, "y", true), plot.valToPos(from, "y", true)];
        ctx.fillStyle = `${colour(name)}1a`;
        ctx.fillRect(bbox.left, top, bbox.width, bottom - top);
      };
      ctx.save();
      across(0, told.watch, "watch");
      across(plot.scales.y.min, 0, "change");
      ctx.fillStyle = ctx.strokeStyle = colour("muted");
      ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
      told.marks.forEach(([at, text, row]) => {
        const x = plot.valToPos(at, "x", true);
        const isLate = x > bbox.left + 0.75 * bbox.width;
        ctx.textAlign = isLate ? "right" : "left";
        ctx.fillRect(x, bbox.top, 1, bbox.height);
        if (row !== null) ctx.fillText(text, x + (isLate ? -4 : 4), bbox.top + (14 + 16 * row) * devicePixelRatio);
      });
      ctx.restore();
    };
    const nearest = (plot, past) => {
      const at = plot.posToVal(plot.cursor.left, "x");
      return past.x.reduce((best, x, one) => (past.events[one] && Math.abs(x - at) < Math.abs(past.x[best] - at) ? one : best), 0);
    };
    const tell = (plot) => {
      if (plot.cursor.left < 0) { said.textContent = ""; return; }
      const one = nearest(plot, first);
      said.textContent = `${Math.round(first.x[one]).toLocaleString("en")}: ${first.title} ${Math.round(first.left[one])} % left. A click opens the event.`;
    };
    const { width, height } = picture.getBoundingClientRect();
    const room = Math.max(height, LEAST_PX); // of a telephone the picture is low
    picture.style.marginBottom = `${room - height}px`;
    chart = new uPlot({
      width,
      height: room - 24,
      series,
      bands,
      legend: { show: false },
      cursor: { y: false, drag: { x: true, y: false } },
      scales: { x: { time: false }, y: { range: told.range } },
      axes: [{ ...axis, label: told.label, size: 34, labelSize: 20 }, { ...axis, label: "friction margin [%]", labelSize: 20 }],
      hooks: { drawClear: [mark], setCursor: [tell] },
    }, all, place);
    place.append(said);
    chart.over.addEventListener("click", () => {
      if (chart.select.width > 0) return; // a stretch was marked to look closer
      const [stream, seq] = first.events[nearest(chart, first)];
      location.assign(`${location.pathname}/shift?${new URLSearchParams({ stream: told.streams[stream], seq })}`);
    });
  };

  const again = (() => { let timer = 0; return () => { clearTimeout(timer); timer = setTimeout(draw, 100); }; })();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  addEventListener("resize", again);
  const shown = document.getElementById("live");
  if (shown) new MutationObserver(draw).observe(shown, { childList: true });
  draw();
})();
