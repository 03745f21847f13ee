// SPDX-License-Identifier: Apache-2.0
// Draws the plots of a page of `fjr report` with uPlot. Reads the plots from the JSON element "plots" (report/html.py).
"use strict";
(() => {
  const [HEIGHT, LOW] = [280, 210];
  const NEAR = 20; // px across, within which the dot next to the pointer is looked for
  const SUPERSCRIPT = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
  const sync = uPlot.sync("time");

  const heightOf = (spec) => (spec.legend ? HEIGHT : LOW);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const raised = (exponent) => "10" + String(exponent).replace(/./g, (digit) => SUPERSCRIPT[digit]);

  const page = JSON.parse(document.getElementById("plots").textContent);

  // Decode array number `place` (class Pool in report/html.py).
  function numbers(place) {
    const [kind, count, text] = page.arrays[place].split(":");
    const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const found = kind === "d" ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
    const values = Array.from(found, (value) => (Number.isFinite(value) ? value : null));
    return values.length < Number(count) ? new Array(Number(count)).fill(values[0]) : values;
  }

  function written(value) {
    if (value == null) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-3 || size >= 1e5)) {
      const [mantissa, exponent] = value.toExponential(2).split("e");
      return `${Number(mantissa)}·${raised(Number(exponent))}`;
    }
    return String(Number(value.toPrecision(4)));
  }

  // Return the ticks of a log axis: powers of ten, as many as fit; 1, 2, 5 if it spans few decades; even steps within one.
  function logSplits(plot, axis, low, high) {
    const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
    const room = (axis === 0 ? plot.bbox.width / 45 : plot.bbox.height / 34) / devicePixelRatio;
    const ticks = [];
    if (high < 10 * low) {
      const least = (high - low) / Math.min(room, 6);
      const power = 10 ** Math.floor(Math.log10(least));
      const step = power * [1, 2, 5, 10].find((digit) => digit * power >= least);
      for (let count = Math.ceil(low / step); count * step <= high; count++) ticks.push(count * step);
      return ticks;
    }
    const digits = last - first <= 3 && 3 * (last - first) <= 1.2 * room ? [1, 2, 5] : [1];
    const step = Math.max(1, Math.ceil(Math.log10(high / low) / room));
    for (let power = Math.ceil(first / step) * step; power <= last; power += step) {
      for (const digit of digits) ticks.push(digit * 10 ** power);
    }
    return ticks.filter((tick) => tick >= low && tick <= high);
  }

  // Label all ticks alike: as numbers within three decades of 1, else as powers of ten.
  function logLabels(_plot, ticks) {
    const plain = ticks.every((tick) => tick >= 0.99e-3 && tick <= 1.01e3);
    return ticks.map((tick) => {
      const exponent = plain ? 0 : Math.floor(Math.log10(tick) + 1e-9);
      const digit = Number((tick / 10 ** exponent).toPrecision(3));
      return exponent === 0 ? String(digit) : digit === 1 ? raised(exponent) : `${digit}·${raised(exponent)}`;
    });
  }

  // uPlot's own labels have three decimals only.
  function labels(_plot, ticks) {
    const small = ticks.every((tick) => Math.abs(tick) < 1e-3);
    return ticks.map((tick) => (small && tick ? written(tick) : String(Number(tick.toPrecision(8)))));
  }

  // An axis of values is as wide as its labels, and at least as wide as that of other plots.
  const wide = (least) => (_plot, texts) => Math.max(least, 14 + 6.5 * Math.max(0, ...(texts || []).map((text) => text.length)));

  function axis(label, log, across, small) {
    const look = {
      label,
      labelSize: across ? 22 : 20,
      labelFont: "12px system-ui, sans-serif",
      font: "12px system-ui, sans-serif",
      stroke: () => css("soft"),
      grid: { stroke: () => css("grid"), width: 1 },
      ticks: { show: false },
      size: across ? 28 : wide(small ? 42 : 58),
      values: labels,
    };
    if (log) Object.assign(look, { splits: logSplits, values: logLabels, filter: (_plot, ticks) => ticks });
    return look;
  }

  function range(log, [low, high]) {
    return (_plot, least, most) => {
      if (least == null) return log ? [0.1, 1] : [0, 1];
      if (log) return [low ?? 10 ** (Math.log10(least) - 0.15), high ?? 10 ** (Math.log10(most) + 0.15)];
      const room = 0.06 * (most - least || Math.abs(most) || 1);
      return [low ?? least - room, high ?? most + room];
    };
  }

  const nothing = () => null;
  // The legend shows values only where a cursor is.
  const reading = (plot) => plot.root.classList.toggle("reading", plot.legend.idx != null);

  function line(spec) {
    return {
      label: spec.label || " ",
      class: spec.unseen ? "unseen" : null,
      stroke: () => css(spec.colour),
      fill: spec.fill ? () => css(spec.colour) + "40" : undefined,
      width: spec.width,
      dash: spec.dash.length ? spec.dash : undefined,
      cap: "round",
      paths: spec.dots || spec.unseen ? nothing : spec.step ? uPlot.paths.stepped({ align: 1 }) : undefined,
      points: { show: spec.dots, size: 3.5, width: 0, fill: () => css(spec.colour) + "90" },
      spanGaps: false,
      value: (_plot, value) => written(value),
      scale: spec.unseen ? "unseen" : "y",
    };
  }

  // Return options of uPlot's cursor that choose the dot next to the pointer; uPlot alone looks across only.
  function cursorOfDots(lines) {
    const columns = lines.flatMap((each, number) => (each.dots ? [number + 1] : []));
    let [left, top] = [0, 0];
    const move = (_plot, ...place) => ([left, top] = place);
    const dataIdx = (plot, _series, hovered) => {
      let [best, least] = [hovered, Infinity];
      const closer = (row) => {
        const across = plot.valToPos(plot.data[0][row], "x") - left;
        for (const column of columns) {
          const value = plot.data[column][row];
          const distance = value == null ? Infinity : Math.hypot(across, plot.valToPos(value, "y") - top);
          if (distance < least) [best, least] = [row, distance];
        }
        return Math.abs(across) < NEAR;
      };
      for (let row = hovered; row < plot.data[0].length && closer(row); row++);
      for (let row = hovered - 1; row >= 0 && closer(row); row--);
      return best;
    };
    const colour = (_plot, series) => (lines[series - 1].unseen ? "transparent" : css(lines[series - 1].colour));
    return { move, dataIdx, points: { size: 8, fill: colour, stroke: colour } };
  }

  function cursor(spec) {
    if (spec.lines.some((each) => each.dots)) return cursorOfDots(spec.lines);
    return { ...(spec.time ? { sync: { key: sync.key, scales: ["x", null] } } : {}), points: { size: 6 } };
  }

  function options(spec, width) {
    const across = { label: spec.x_label, value: (_plot, value) => written(value) };
    return {
      width,
      height: heightOf(spec),
      series: [across, ...spec.lines.map(line)],
      scales: {
        x: { time: false, distr: spec.x_log ? 3 : 1, range: spec.x_log ? (_plot, low, high) => [low, high] : undefined },
        y: { distr: spec.y_log ? 3 : 1, range: range(spec.y_log, spec.y_range) },
      },
      bands: spec.band ? [{ series: spec.band.map((number) => number + 1), fill: () => css("c1") + "30" }] : [],
      axes: [axis(spec.x_label, spec.x_log, true, !spec.legend), axis(spec.y_label, spec.y_log, false, !spec.legend)],
      cursor: cursor(spec),
      legend: { show: spec.legend, live: true },
      hooks: { setLegend: [reading] },
      padding: [10, 20, 0, 0],
    };
  }

  function data(spec) {
    return [numbers(spec.x), ...spec.lines.map((each) => numbers(each.values))];
  }

  function hideUnnamed(plot) {
    plot.root.querySelectorAll(".u-legend .u-series").forEach((row) => {
      if (!row.querySelector(".u-label").textContent.trim()) row.style.display = "none";
    });
  }

  function draw(spec, place, width) {
    const plot = new uPlot(options(spec, width), data(spec), place);
    hideUnnamed(plot);
    if (spec.time) {
      sync.sub(plot);
      plot.over.addEventListener("mousemove", () => {
        document.dispatchEvent(new CustomEvent("plot-time", { detail: plot.posToVal(plot.cursor.left, "x") }));
      });
    }
    return plot;
  }

  function element(kind, parent, text, name) {
    const made = document.createElement(kind);
    if (text) made.textContent = text;
    if (name) made.className = name;
    return parent.appendChild(made);
  }

  const drawn = [];

  // Add the figure of a plot without the plot itself: the widths of all figures count on how many there are.
  function frame(spec) {
    const figure = element("figure", document.getElementById(spec.place), "", spec.wide ? "wide" : "");
    figure.id = spec.name;
    const views = Object.keys(spec.views);
    const buttons = views.length ? element("span", figure, "", "views") : null;
    element("h2", figure, spec.title);
    element("figcaption", figure, spec.caption);
    return { spec, buttons, place: element("div", figure) };
  }

  function show({ spec, buttons, place }) {
    const entry = { place, plot: null, height: heightOf(spec), time: spec.time };
    const use = (chosen) => {
      if (entry.plot) {
        sync.unsub(entry.plot);
        entry.plot.destroy();
      }
      entry.plot = draw(chosen, place, Math.floor(place.clientWidth));
    };
    use(spec);
    if (buttons) swap(buttons, spec, Object.keys(spec.views)[0], use);
    drawn.push(entry);
  }

  // Add a button that switches the plot to other units and back.
  function swap(place, spec, name, use) {
    const button = element("button", place, name);
    const [here, other] = [spec.y_label.replace(/.*\[(.*)\]/, "$1"), name];
    let away = false;
    button.title = `show in ${name}`;
    button.onclick = () => {
      away = !away;
      use(away ? { ...spec, ...spec.views[name], views: {} } : spec);
      button.textContent = away ? here : other;
    };
  }

  page.plots.map(frame).forEach(show);
  addEventListener("resize", () =>
    drawn.forEach(({ place, plot, height }) => plot.setSize({ width: Math.floor(place.clientWidth), height })),
  );
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () =>
    drawn.forEach(({ plot }) => plot.redraw(false, true)),
  );
  // Move the cursors to a time; a plot whose range lacks it shows none.
  document.addEventListener("arm-time", ({ detail }) =>
    drawn.filter(({ time }) => time).forEach(({ plot }) => {
      const left = plot.valToPos(detail, "x");
      const inside = left >= 0 && left <= plot.over.clientWidth;
      plot.setCursor({ left: inside ? left : -10, top: -10 }, true, false);
    }),
  );
  document.body.dataset.drawn = String(drawn.length);
})();
