/* The page's behaviour: theme, charts, tables. It needs nothing but uPlot and the page itself. */
"use strict";
(() => {
  const root = document.documentElement;
  const arrays = {};
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  for (const block of document.querySelectorAll("script.arrays")) Object.assign(arrays, JSON.parse(block.textContent));
  const floats = (key) => {
    if (typeof arrays[key] === "string") arrays[key] = new Float32Array(bytes(arrays[key]).buffer);
    return arrays[key];
  };
  const colour = (name) => getComputedStyle(root).getPropertyValue(`--${name}`).trim();

  // ---- theme: what the system asks for, until the switch is used
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme || (dark.matches ? "dark" : "light")) === "dark";
  const themeButton = document.getElementById("theme");
  const label = () => { if (themeButton) themeButton.textContent = isDark() ? "Light theme" : "Dark theme"; };
  const repaint = () => { label(); plots.forEach((plot) => plot.redraw(false)); };
  themeButton?.addEventListener("click", () => { root.dataset.theme = isDark() ? "light" : "dark"; repaint(); });
  dark.addEventListener("change", repaint);

  // ---- time series; charts of one group zoom and point together
  const plots = [];
  const groups = {};
  const shade = (masked) => (plot) => {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.fillStyle = colour("shade");
    for (let k = 0; k + 1 < masked.length; k += 2) {
      const left = plot.valToPos(masked[k], "x", true), right = plot.valToPos(masked[k + 1], "x", true);
      if (right >= bbox.left && left <= bbox.left + bbox.width) ctx.fillRect(left, bbox.top, Math.max(right - left, 1), bbox.height);
    }
    ctx.restore();
  };
  const digits = (value) => (value == null || Number.isNaN(value) ? "–" : Number(value.toPrecision(4)).toString().replaceAll("-", "\u2212"));

  function zoom(group, min, max) {
    const all = groups[group], [first, last] = all.extent;
    const span = Math.max(Math.min(max - min, last - first), (last - first) * 1e-4);
    min = Math.max(first, Math.min(min, last - span));
    all.range = [min, min + span];
    for (const plot of all.plots) if (plot.scales.x.min !== min || plot.scales.x.max !== min + span) plot.setScale("x", { min, max: min + span });
  }

  function pinch(over, group) { // two fingers zoom and pan; one finger scrolls the page
    let from = null;
    const at = (touches) => {
      const box = over.getBoundingClientRect();
      return [...touches].map((touch) => (touch.clientX - box.left) / box.width).sort((a, b) => a - b);
    };
    over.style.touchAction = "pan-y";
    over.addEventListener("touchstart", (event) => {
      if (event.touches.length !== 2) return;
      from = { at: at(event.touches), range: [...groups[group].range] };
      event.preventDefault();
    }, { passive: false });
    over.addEventListener("touchmove", (event) => {
      if (!from || event.touches.length !== 2) return;
      event.preventDefault();
      const [a, b] = from.at, [low, high] = from.range, now = at(event.touches);
      const seconds = ((b - a) * (high - low)) / Math.max(now[1] - now[0], 0.02);
      const min = low + a * (high - low) - now[0] * seconds;
      zoom(group, min, min + seconds);
    }, { passive: false });
    over.addEventListener("touchend", () => { from = null; });
  }

  function draw(element) {
    if (element.dataset.drawn) return;
    element.dataset.drawn = "yes";
    const spec = JSON.parse(element.dataset.chart);
    const time = floats(spec.x), group = spec.group;
    groups[group] ??= { plots: [], extent: [time[0], time[time.length - 1]], range: [time[0], time[time.length - 1]] };
    const all = groups[group];
    const gaps = (values) => Array.from(values, (v) => (Number.isNaN(v) ? null : v));
    const data = [time, ...spec.series.map((s) => gaps(floats(s.data)))];
    const axis = { stroke: () => colour("soft"), grid: { stroke: () => colour("grid"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    const plot = new uPlot({
      width: Math.max(element.clientWidth, 120), height: spec.height,
      scales: { x: { time: false, range: () => all.range }, y: spec.from === undefined ? {} : { range: (_, low, high) => [spec.from, Math.max(high * 1.05, spec.from + 1e-12)] } },
      legend: { show: true, live: true },
      cursor: { sync: { key: group, setSeries: false }, drag: { x: true, y: false, setScale: false }, points: { size: 5 } },
      axes: [
        { ...axis, size: spec.last ? 20 : 6, gap: 2, ...(spec.last ? { label: spec.xlabel, labelSize: 16, labelFont: "11px system-ui, sans-serif" } : { values: (_, ticks) => ticks.map(() => "") }) },
        { ...axis, size: 58, space: spec.height < 130 ? 14 : 30, values: (_, ticks) => ticks.map(digits), label: spec.unit, labelSize: 16, labelFont: "11px system-ui, sans-serif" },
      ],
      series: [
        { label: "t, s", value: (_, v) => (v == null ? "–" : v.toFixed(3)) },
        ...spec.series.map((s) => ({
          label: s.label, stroke: () => colour(s.colour), width: s.width, dash: s.dash, spanGaps: false, points: { show: false }, value: (_, v) => digits(v),
        })),
      ],
      hooks: {
        drawClear: spec.masked ? [shade(floats(spec.masked))] : [],
        setSelect: [(u) => {
          if (u.select.width < 4) return;
          const min = u.posToVal(u.select.left, "x"), max = u.posToVal(u.select.left + u.select.width, "x");
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          zoom(group, min, max);
        }],
        ready: [(u) => {
          pinch(u.over, group);
          u.over.addEventListener("dblclick", () => zoom(group, ...all.extent));
        }],
      },
    }, data, element);
    all.plots.push(plot);
    plots.push(plot);
    element.plot = plot;
  }

  // Charts are drawn one after the other, so that a long page answers at once; those in a folded part when it unfolds.
  const charts = [...document.querySelectorAll(".chart")];
  const visible = (chart) => chart.clientWidth > 0;
  const rest = () => {
    const next = charts.find((chart) => !chart.dataset.drawn && visible(chart));
    if (!next) return;
    draw(next);
    setTimeout(rest, 0);
  };
  const fit = () => {
    charts.forEach((chart) => {
      if (chart.plot && visible(chart) && chart.clientWidth !== chart.plot.width) chart.plot.setSize({ width: chart.clientWidth, height: chart.plot.height });
    });
    rest();
  };
  rest();
  new ResizeObserver(() => requestAnimationFrame(fit)).observe(document.body);
  document.addEventListener("toggle", fit, true);

  const moves = { whole: null, in: [0.25, 0.75], out: [-0.5, 1.5], back: [-0.5, 0.5], on: [0.5, 1.5] };
  for (const button of document.querySelectorAll("button[data-zoom]")) {
    button.addEventListener("click", () => {
      const all = groups[button.dataset.group], part = moves[button.dataset.zoom];
      if (!all) return;
      if (!part) { zoom(button.dataset.group, ...all.extent); return; }
      const [low, high] = all.range;
      zoom(button.dataset.group, low + part[0] * (high - low), low + part[1] * (high - low));
    });
  }

  // ---- a link to a folded section unfolds it
  const reveal = () => document.querySelector(`${location.hash || "#none"} > details`)?.setAttribute("open", "");
  addEventListener("hashchange", reveal);
  reveal();

  // ---- paper: everything is drawn in the light theme, and opened
  let theme;
  const beforePaper = () => {
    theme = root.dataset.theme;
    root.dataset.theme = "light";
    document.querySelectorAll("details").forEach((part) => { part.dataset.was = part.open; part.open = true; });
    charts.forEach(draw);
    fit();
    repaint();
  };
  const afterPaper = () => {
    if (theme) root.dataset.theme = theme; else delete root.dataset.theme;
    document.querySelectorAll("details").forEach((part) => { part.open = part.dataset.was === "true"; });
    repaint();
  };
  addEventListener("beforeprint", beforePaper);
  addEventListener("afterprint", afterPaper);

  // ---- tables that sort and search
  for (const table of document.querySelectorAll("table.sortable")) {
    const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
    const key = (row, column) => {
      const cell = row.cells[column], number = cell.dataset.value;
      return number === undefined ? cell.textContent.trim().toLowerCase() : number === "" ? Infinity : Number(number);
    };
    const sort = (head, column) => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const rows = [...body.rows].map((row) => [key(row, column), row]);
      rows.sort(([a], [b]) => (a < b ? -1 : a > b ? 1 : 0) * (up ? 1 : -1));
      body.append(...rows.map(([, row]) => row));
    };
    heads.forEach((head, column) => {
      if (!head.dataset.sort) return;
      head.tabIndex = 0;
      head.addEventListener("click", () => sort(head, column));
      head.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); sort(head, column); } });
    });
  }
  for (const input of document.querySelectorAll("input[data-table]")) {
    const rows = [...document.getElementById(input.dataset.table).tBodies[0].rows], count = input.parentElement.querySelector("output");
    const search = () => {
      const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
      let shown = 0;
      for (const row of rows) {
        row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
        shown += row.hidden ? 0 : 1;
      }
      if (count) count.textContent = `${shown} of ${rows.length}`;
    };
    input.addEventListener("input", search);
    search();
  }

  label();
  root.dataset.ready = "yes";
})();
