// Replaces each static chart by an interactive chart of the same data. A drag zooms, a double click shows everything, the
// pointer shows values, and a click on a throw opens its page. All charts of a page share the zoom and the cursor.
"use strict";
{
  const RATIO = 0.68; // height / width of a chart: with its title and names it is as high as a static chart
  const NEAR_PX = 15; // largest distance from a throw to a click that opens it
  const DOUBLE_MS = 300; // time that a click waits for the second click of a double click
  const ROWS = 3; // rows of labels above a chart; a mark for whose label there is no space is only a line
  const ROW_PX = 14;
  const FONT = "12px system-ui, sans-serif";

  let charts = [];
  let addresses = new Map(); // from the time of a throw to the path of its page
  let zoom = null; // shown range of x; null for all data
  let picked = null; // x of the point under the pointer
  let opening = 0;

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const of = (name) => style.getPropertyValue(`--${name}`).trim();
    return { ink: of("ink"), line: of("line"), paper: of("paper"), curves: [1, 2, 3, 4].map((at) => of(`curve-${at}`)) };
  }

  // Returns the index of the point nearest to the pointer if it is near, else `index`, the point nearest in time. Notes in
  // the chart whether the pointer is near the point.
  function nearest(chart, index) {
    const { left, top } = chart.cursor;
    let best = { index, distance: NEAR_PX };
    chart.data[0].forEach((x, at) => {
      const aside = Math.abs(chart.valToPos(x, "x") - left);
      if (aside >= best.distance) return;
      for (const column of chart.data.slice(1)) {
        if (column[at] == null) continue;
        const distance = Math.hypot(aside, chart.valToPos(column[at], "y") - top);
        if (distance < best.distance) best = { index: at, distance };
      }
    });
    chart.isNear = best.distance < NEAR_PX;
    return best.index;
  }

  // The value of a curve at an index. A curve over the time of a throw may have no sample at this time: then the nearest.
  function value(column, at, isHistory) {
    const furthest = isHistory ? 0 : column.length;
    for (let by = 0; by <= furthest; by++) {
      const found = column[at - by] ?? column[at + by];
      if (found != null) return found;
    }
    return null;
  }

  function times(second) {
    const at = new Date(second * 1000);
    const utc = `${at.toISOString().slice(0, 19).replace("T", " ")} UTC`;
    return at.getTimezoneOffset() === 0 ? utc : `${utc} (${at.toLocaleString(undefined, { timeZoneName: "short" })})`;
  }

  // Writes time, values and throw of a point below the caption.
  function read(chart, panel, at) {
    const x = chart.data[0][at];
    const texts = [panel.times ? times(x) : `${Number(x.toFixed(4))} ${panel.x_label}`];
    panel.curves.forEach((curve, number) => {
      const y = value(chart.data[number + 1], at, panel.times);
      if (curve.reach.length > 0 || y === null) return;
      texts.splice(1, 0, curve.dots ? curve.name : `${curve.name} ${y.toPrecision(4)} ${panel.y_label.replace(/ from .*/, "")}`.replace(" -", " −"));
    });
    chart.readout.textContent = texts.join(" · ");
    const address = addresses.get(x);
    if (address) {
      const link = document.createElement("a");
      link.href = address;
      link.textContent = `throw ${address.split("/").pop()}`;
      chart.readout.append(" · ", link);
    }
  }

  function dashed(chart, ink, from, to) {
    const { ctx } = chart;
    ctx.strokeStyle = ink;
    ctx.lineWidth = uPlot.pxRatio;
    ctx.setLineDash([6 * uPlot.pxRatio, 4 * uPlot.pxRatio]);
    ctx.beginPath();
    ctx.moveTo(...from);
    ctx.lineTo(...to);
    ctx.stroke();
  }

  // Draws a text with an outline, so that it is readable over lines.
  function label(chart, colour, text, x, y, align) {
    const { ctx } = chart;
    Object.assign(ctx, { font: FONT.replace("12", 12 * uPlot.pxRatio), textAlign: align, textBaseline: "alphabetic" });
    Object.assign(ctx, { strokeStyle: colour.paper, fillStyle: colour.ink, lineWidth: 4 * uPlot.pxRatio, lineJoin: "round" });
    ctx.setLineDash([]);
    ctx.strokeText(text, x, y);
    ctx.fillText(text, x, y);
  }

  // Draws the band of scatter below the curves.
  function drawBand(chart, panel) {
    const { ctx, bbox } = chart;
    for (const curve of panel.curves.filter((curve) => curve.reach.length > 0)) {
      const corner = ([x, y], reach) => [chart.valToPos(x, "x", true), chart.valToPos(y + reach, "y", true)];
      const upper = curve.points.map((point, at) => corner(point, curve.reach[at]));
      const lower = curve.points.map((point, at) => corner(point, -curve.reach[at]));
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      ctx.beginPath();
      upper.concat(lower.reverse()).forEach((place) => ctx.lineTo(...place));
      ctx.globalAlpha = 0.2;
      ctx.fillStyle = curve.colour;
      ctx.fill();
      ctx.restore();
    }
  }

  // Draws limits as horizontal lines, and marks as vertical lines with labels above the chart.
  function drawLines(chart, panel, colour) {
    const { ctx, bbox } = chart;
    const [right, bottom] = [bbox.left + bbox.width, bbox.top + bbox.height];
    ctx.save();
    for (const [y, text] of panel.levels) {
      const at = chart.valToPos(y, "y", true);
      dashed(chart, colour.ink, [bbox.left, at], [right, at]);
      // Near the top, the text goes below the line, as the labels of the marks are above the chart.
      const down = at < bbox.top + 16 * uPlot.pxRatio ? 13 : -4;
      label(chart, colour, text, bbox.left + 4 * uPlot.pxRatio, at + down * uPlot.pxRatio, "left");
    }
    const ends = Array(ROWS).fill(-Infinity);
    for (const [x, text] of panel.marks) {
      const at = chart.valToPos(x, "x", true);
      if (at < bbox.left - 1 || at > right + 1) continue;
      ctx.font = FONT.replace("12", 12 * uPlot.pxRatio);
      const half = ctx.measureText(text).width / 2;
      const centre = Math.min(Math.max(at, half), ctx.canvas.width - half);
      const row = ends.findIndex((end) => end + 8 * uPlot.pxRatio < centre - half);
      const top = bbox.top - (4 + ROW_PX * Math.max(row, 0)) * uPlot.pxRatio;
      dashed(chart, colour.ink, [at, top], [at, bottom]);
      if (row < 0) continue;
      ends[row] = centre + half;
      label(chart, colour, text, centre, top - 3 * uPlot.pxRatio, "center");
    }
    ctx.restore();
  }

  function heightOf(panel, width) {
    return Math.round(width * RATIO) + ROW_PX * Math.min(ROWS, panel.marks.length);
  }

  function options(panel, colour, width) {
    const edges = panel.curves.flatMap((curve) => curve.points.flatMap(([, y], at) => {
      const reach = curve.reach[at];
      return reach === undefined ? [] : [y - reach, y + reach];
    }));
    const kept = [...edges, ...panel.levels.map(([y]) => y)];
    const axis = { stroke: colour.ink, font: FONT, labelFont: FONT, labelSize: 17, labelGap: 0, grid: { stroke: colour.line, width: 1 }, ticks: { show: false } };
    // For each least step [s]: the label, and its second line where year, month, day, hour or minute changes. The year has its
    // own line, as a date with its year is wider than the least space between two labels.
    const dates = [
      [31536000, "{YYYY}", null, null, null, null, null, null, 1],
      [2419200, "{MMM}", "\n{YYYY}", null, null, null, null, null, 1],
      [86400, "{D} {MMM}", "\n{YYYY}", null, null, null, null, null, 1],
      [60, "{HH}:{mm}", "\n{D} {MMM}", null, "\n{D} {MMM}", null, null, null, 1],
      [1, "{HH}:{mm}:{ss}", "\n{D} {MMM}", null, "\n{D} {MMM}", null, null, null, 1],
      [0.001, "{ss}.{fff}", "\n{D} {MMM} {HH}:{mm}", null, "\n{D} {MMM} {HH}:{mm}", null, "\n{HH}:{mm}", null, 1],
    ];
    return {
      title: panel.title,
      width,
      height: heightOf(panel, width),
      padding: [6 + ROW_PX * Math.min(ROWS, panel.marks.length), 14, 0, 0],
      tzDate: (second) => uPlot.tzDate(new Date(second * 1000), "Etc/UTC"),
      legend: { show: false },
      scales: {
        // For a single throw uPlot would choose an axis of almost three years.
        x: { time: panel.times, range: (chart, low, high) => (panel.times && chart.data[0].length === 1 ? [low - 30, low + 30] : [low, high]) },
        y: {
          range: (_, low, high) => {
            const shown = [...kept, low, high].filter(Number.isFinite);
            return shown.length > 0 ? uPlot.rangeNum(Math.min(...shown), Math.max(...shown), 0.05, true) : [0, 1];
          },
        },
      },
      axes: [
        { ...axis, label: panel.x_label, ...(panel.times ? { values: dates, size: 40 } : { size: 26 }) },
        { ...axis, label: panel.y_label, size: 44 },
      ],
      series: [{}, ...panel.curves.map((curve) => ({
        label: curve.name,
        stroke: curve.colour,
        width: 1.8,
        ...(curve.dots ? { paths: () => null, points: { show: true, size: 6, fill: curve.colour } } : {}),
      }))],
      cursor: {
        sync: { key: "page", scales: ["x", null] },
        drag: { x: true, y: false, dist: 5 },
        dataIdx: (chart, series, index) => {
          if (series > 0) return chart.at;
          if (chart.cursor.event) {
            chart.at = nearest(chart, index);
            picked = chart.data[0][chart.at];
          } else {
            const same = chart.data[0].indexOf(picked);
            chart.at = same < 0 ? index : same;
          }
          return chart.at;
        },
      },
      hooks: {
        drawAxes: [(chart) => drawBand(chart, panel)],
        draw: [(chart) => drawLines(chart, panel, colour)],
        setCursor: [(chart) => {
          if (chart.cursor.idx == null) return;
          read(chart, panel, chart.at);
          chart.over.style.cursor = chart.isNear && addresses.has(picked) ? "pointer" : "";
        }],
        setScale: [(chart, key) => {
          if (key !== "x") return;
          const { min, max } = chart.scales.x;
          zoom = min > chart.data[0][0] || max < chart.data[0].at(-1) ? { min, max } : null;
        }],
      },
    };
  }

  function build(figure) {
    const panel = JSON.parse(figure.querySelector("script").textContent);
    // Without the gap after each dot, which has the same time as the dot.
    for (const curve of panel.curves.filter((curve) => curve.dots)) curve.points = curve.points.filter(([, y]) => y !== null);
    // The curves are drawn in reverse order, so that the first is on top.
    const colour = colours();
    panel.curves.forEach((curve, number) => { curve.colour = colour.curves[number % colour.curves.length]; });
    panel.curves.reverse();
    const columns = panel.curves.map(({ points }) => [points.map(([x]) => x), points.map(([, y]) => y)]);
    const holder = document.createElement("div");
    const names = document.createElement("p");
    names.className = "names";
    for (const curve of panel.curves.filter((curve) => curve.name)) {
      const name = document.createElement("span");
      name.textContent = curve.name;
      name.style.setProperty("--curve", curve.colour);
      names.prepend(name);
    }
    const readout = document.createElement("p");
    readout.className = "readout";
    figure.classList.add("live");
    figure.querySelectorAll("div, .readout").forEach((old) => old.remove());
    figure.querySelector("figcaption").before(holder);
    const chart = new uPlot(options(panel, colour, holder.clientWidth), uPlot.join(columns), holder);
    chart.root.querySelector(".u-title").after(names);
    figure.append(readout);
    Object.assign(chart, { panel, readout });
    const before = chart.data[0].indexOf(picked);
    if (before >= 0) read(chart, panel, before);
    chart.over.addEventListener("click", (event) => {
      clearTimeout(opening);
      const address = chart.isNear && addresses.get(picked);
      // A finger cannot hover: a touch only shows the values, with a link that opens the throw.
      if (address && event.pointerType !== "touch") opening = setTimeout(() => location.assign(address), DOUBLE_MS);
    });
    chart.over.addEventListener("dblclick", () => clearTimeout(opening));
    return chart;
  }

  function buildAll() {
    charts.forEach((chart) => chart.destroy());
    const kept = zoom;
    const drawn = JSON.parse(document.getElementById("drawn")?.textContent ?? "[]");
    addresses = new Map(drawn.map(([x, path]) => [x, `${location.pathname}/throws/${path}`]));
    const figures = [...document.querySelectorAll("figure:has(> script)")];
    charts = figures.map(build);
    if (kept) charts.forEach((chart) => chart.setScale("x", kept));
    const help = document.createElement("p");
    help.className = "fine help";
    help.textContent = `In a chart: drag to zoom, double click to show everything${drawn.length > 0 ? ", click on a throw to open it" : ""}.`;
    document.querySelector(".help")?.remove();
    figures[0]?.parentElement.before(help);
  }

  if (typeof uPlot !== "undefined") {
    buildAll();
    document.addEventListener("replaced", buildAll);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", buildAll);
    addEventListener("resize", () => charts.forEach((chart) => {
      const width = chart.root.parentElement.clientWidth;
      if (width !== chart.width) chart.setSize({ width, height: heightOf(chart.panel, width) });
    }));
  }
}
