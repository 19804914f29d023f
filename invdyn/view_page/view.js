// The body and its curves on one time axis. Rows of all arrays are the data's times; null is missing.
(() => {
  "use strict";
  const find = (id) => document.getElementById(id);
  const data = JSON.parse(find("view-data").textContent);
  const { time, panels, space } = data, last = time.length - 1;  // a study has no body: then there is no space
  const slider = find("slider"), button = find("play"), speed = find("speed"), canvas = find("picture");
  const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const HEIGHT = 165;  // px of a chart
  let row = 0, playing = false, before = 0, clock = 0, yaw = 0.5, pitch = 0.25, charts = [];
  document.body.classList.toggle("space", space === 3);

  // Numbers and words
  const short = (value) => (value === null ? "–" : Number(value.toPrecision(3)).toString().replace("-", "−"));
  const fixed = (value, digits) => Number(value.toFixed(digits)).toFixed(digits).replace("-", "−");  // no −0
  const interval = ({ low, middle, high }, at, factor) => {  // two digits of the interval's width
    if (middle[at] === null) return "–";
    const own = [middle, low, high].map((each) => factor * each[at]);
    if (low[at] === high[at]) return short(own[0]);
    const digits = Math.min(Math.max(1 - Math.floor(Math.log10(own[2] - own[1])), 0), 6);
    const [m, l, h] = own.map((each) => fixed(each, digits));
    return `${m} [${l}, ${h}]`;
  };
  const clocked = (at) => `${fixed(time[at], 2)} s`;

  // The body, as seen from yaw (about the vertical axis) and pitch, rad
  function seen([x, y, z]) {
    if (space === 2) return [x, y];
    const across = x * Math.cos(yaw) + y * Math.sin(yaw), away = y * Math.cos(yaw) - x * Math.sin(yaw);
    return [across, z * Math.cos(pitch) + away * Math.sin(pitch)];
  }
  function drawBody() {
    if (!canvas) return;
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio; canvas.height = height * ratio;
    const pen = canvas.getContext("2d"), [low, high] = data.box, edge = 26;
    pen.scale(ratio, ratio);
    const corners = [];
    for (let each = 0; each < 2 ** space; each += 1)
      corners.push(seen(low.map((value, axis) => (each >> axis) & 1 ? high[axis] : value)));
    const [left, bottom] = [0, 1].map((axis) => Math.min(...corners.map((corner) => corner[axis])));
    const [right, top] = [0, 1].map((axis) => Math.max(...corners.map((corner) => corner[axis])));
    const scale = Math.min((width - 2 * edge) / (right - left), (height - 2 * edge) / (top - bottom));
    const place = (point) => {
      const [across, up] = seen(point);
      return [width / 2 + (across - (left + right) / 2) * scale, height / 2 - (up - (bottom + top) / 2) * scale];
    };
    const chain = (points, style, thick, alpha, dash) => {
      pen.globalAlpha = alpha; pen.strokeStyle = style; pen.lineWidth = thick; pen.lineJoin = pen.lineCap = "round";
      pen.setLineDash(dash ? [9, 5] : []);
      for (const line of data.lines) {
        const spots = line.map((name) => points[name]);
        if (spots.some((spot) => spot.includes(null))) continue;
        pen.beginPath();
        spots.forEach((spot, n) => pen[n ? "lineTo" : "moveTo"](...place(spot)));
        pen.stroke();
      }
      pen.setLineDash([]); pen.globalAlpha = 1;
    };
    for (const each of data.draws) chain(each[row], ink("after"), 3, 0.18);
    for (const arm of data.arms) {
      chain(arm.points[row], ink(arm.style), 4, 1, arm.style === "before");
      pen.fillStyle = ink(arm.style);
      for (const line of data.lines) for (const name of line) {
        if (arm.points[row][name].includes(null)) continue;
        pen.beginPath(); pen.arc(...place(arm.points[row][name]), 4.5, 0, 7); pen.fill();
      }
    }
    pen.strokeStyle = ink("seen"); pen.lineWidth = 2;
    for (const point of data.observed[row] || []) {
      if (point.includes(null)) continue;
      pen.beginPath(); pen.arc(...place(point), 7, 0, 7); pen.stroke();
    }
    pen.fillStyle = pen.strokeStyle = ink("soft"); pen.lineWidth = 1.5; pen.font = "12px system-ui, sans-serif";
    const bar = [1, 2, 5].map((part) => part * 10 ** Math.floor(Math.log10(90 / scale))).filter((l) => l * scale < 110).pop();
    pen.beginPath(); pen.moveTo(12, height - 12); pen.lineTo(12 + bar * scale, height - 12); pen.stroke();
    pen.fillText(`${short(bar)} ${data.unit}`, 12, height - 18);
    if (space === 3) "xyz".split("").forEach((name, axis) => {
      const [across, up] = seen([0, 1, 2].map((each) => (each === axis ? 1 : 0)));
      pen.beginPath(); pen.moveTo(width - 40, height - 36); pen.lineTo(width - 40 + 24 * across, height - 36 - 24 * up);
      pen.stroke();
      pen.fillText(name, width - 43 + 33 * across, height - 32 - 33 * up);
    });
    const named = data.named.map((name, n) => {
      const point = data.arms[data.arms.length - 1].points[row][data.spots[n]];
      return `${name} at ${point.map(short).join(", ")}`;
    });
    canvas.setAttribute("aria-label", `The body at ${clocked(row)}, in ${data.unit}: ${named.join("; ")}`);
  }

  // The curves
  function drawCharts() {
    charts.forEach((chart) => chart.destroy());
    const axis = { stroke: ink("soft"), grid: { stroke: ink("grid"), width: 1 }, ticks: { stroke: ink("grid"), width: 1 } };
    charts = panels.map((panel) => {
      const series = [{}], columns = [time], bands = [];
      const add = (values, options) => { columns.push(values); series.push({ points: { show: false }, ...options }); };
      panel.sides.forEach((side) => {
        for (const [upper, lower, alpha] of [["high", "low", "2e"], ["upper", "lower", "40"]]) {
          if (!side[upper]) continue;
          bands.push({ series: [series.length, series.length + 1], fill: ink(side.style) + alpha });
          add(side[upper], { width: 0 }); add(side[lower], { width: 0 });
        }
      });
      for (const trial of panel.trials) add(trial.values, { stroke: `${ink(trial.style)}66`, width: 0.7 });
      panel.sides.forEach((side) => {
        const dash = side.style === "before" ? [7, 4] : undefined;
        add(side.middle, { stroke: ink(side.style), width: 1.6, dash });
      });
      if (panel.command) add(panel.command, { stroke: ink("seen"), width: 1 });
      if (panel.truth) add(panel.truth, { stroke: ink("ink"), width: 1.2, dash: [5, 3] });
      if (panel.dots) add(panel.dots, { paths: () => null, points: { show: true, size: 4, fill: ink("seen"), stroke: ink("seen") } });
      const element = find(`chart-${panel.id}`);
      const chart = new uPlot({
        width: element.clientWidth, height: HEIGHT, padding: [8, 20, 0, 0], pxAlign: 0, legend: { show: false }, cursor: { show: false }, series, bands,
        scales: { x: { time: false }, y: { range: panel.range } },
        axes: [
          { ...axis, size: 30, space: 72, values: (_, ticks) => ticks.map((tick) => `${String(Number(tick.toFixed(6))).replace("-", "−")} s`) },
          { ...axis, size: 56, label: panel.unit, labelSize: 18, values: (_, ticks) => ticks.map((tick) => short(panel.factor * tick)) },
        ],
      }, columns, element);
      chart.marker = document.createElement("div");
      chart.marker.className = "now";
      chart.over.append(chart.marker);
      chart.event = document.createElement("div");
      chart.event.className = "event";
      if (!space) chart.over.append(chart.event);  // trials are aligned at 0
      let held = false;
      const go = (event) => {
        const at = event.clientX - chart.over.getBoundingClientRect().left;
        play(false); show(nearest(chart.posToVal(at, "x")));
      };
      chart.over.addEventListener("pointerdown", (event) => {
        held = true; chart.over.setPointerCapture(event.pointerId); go(event);
      });
      chart.over.addEventListener("pointermove", (event) => { if (held) go(event); });
      for (const end of ["pointerup", "pointercancel"]) chart.over.addEventListener(end, () => { held = false; });
      return chart;
    });
    mark();
  }
  const mark = () => charts.forEach((chart) => {
    for (const [line, at] of [[chart.marker, time[row]], [chart.event, 0]]) line.style.left = `${chart.valToPos(at, "x")}px`;
  });
  function nearest(wanted) {
    let low = 0, high = last;
    while (high - low > 1) { const middle = (low + high) >> 1; if (time[middle] <= wanted) low = middle; else high = middle; }
    return wanted - time[low] < time[high] - wanted ? low : high;
  }

  // Time
  function show(next) {
    row = Math.min(Math.max(next, 0), last);
    slider.value = row;
    slider.setAttribute("aria-valuetext", clocked(row));
    find("time").textContent = find("now-time").textContent = clocked(row);
    for (const panel of panels) {
      const lines = panel.sides.map((side) => {
        const line = document.createElement("div"), mark = document.createElement("i");
        mark.style.background = `var(--${side.style})`; mark.title = side.name;
        if (panel.sides.length > 1) line.append(mark);
        line.append(`${interval(side, row, panel.factor)} ${panel.unit}`);
        if (panel.sides.length > 1) line.setAttribute("aria-label", `${side.name}: ${line.textContent}`);
        return line;
      });
      find("now").tBodies[0].rows[panel.row].cells[panel.column].replaceChildren(...lines);
    }
    drawBody(); mark();
  }
  function step(now) {
    if (!playing) return;
    clock += (now - before) / 1000 * Number(speed.value);
    before = now;
    if (clock > time[last]) clock = time[0];
    const next = nearest(clock);
    if (next !== row) show(next);
    requestAnimationFrame(step);
  }
  function play(on) {
    if (on === playing) return;
    playing = on;
    button.textContent = on ? "Pause" : "Play";
    if (on) { clock = row === last ? time[0] : time[row]; before = performance.now(); requestAnimationFrame(step); }
  }
  button.addEventListener("click", () => play(!playing));
  slider.addEventListener("input", () => { play(false); show(Number(slider.value)); });
  addEventListener("keydown", (event) => {
    if (event.altKey || event.ctrlKey || event.metaKey || event.target.closest("select, .scroll")) return;
    const size = event.shiftKey ? 10 : 1;
    const moves = { ArrowLeft: row - size, ArrowRight: row + size, Home: 0, End: last };
    if (event.key in moves) { event.preventDefault(); play(false); show(moves[event.key]); }
    else if (event.key === " " && !event.target.closest("button, summary")) { event.preventDefault(); play(!playing); }
  });

  // Turning a body in space
  let turning = null;
  if (space === 3) {
    canvas.addEventListener("pointerdown", (event) => {
      turning = [event.clientX, event.clientY, yaw, pitch]; canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!turning) return;
      yaw = turning[2] - (event.clientX - turning[0]) / 120;
      pitch = Math.min(Math.max(turning[3] + (event.clientY - turning[1]) / 120, -1.5708), 1.5708);
      drawBody();
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { turning = null; });
    document.querySelectorAll(".seen-from").forEach((each) => each.addEventListener("click", () => {
      [yaw, pitch] = [Number(each.dataset.yaw), Number(each.dataset.pitch)]; drawBody();
    }));
  }

  // A table of at most a hundred times, made when it is opened
  find("all").addEventListener("toggle", () => {
    const table = find("all").querySelector("table");
    if (table.tBodies[0].rows.length) return;
    const cell = (line, kind, text) => {
      const made = document.createElement(kind);
      made.textContent = text;
      if (kind === "th") made.scope = "col";
      line.append(made);
    };
    const head = table.tHead.insertRow();
    cell(head, "th", "time, s");
    const columns = panels.flatMap((panel) => panel.sides.map((side) => [panel, side]));
    for (const [panel, side] of columns)
      cell(head, "th", `${panel.joint} ${panel.group}${panel.sides.length > 1 ? ` ${side.name}` : ""}, ${panel.unit}`);
    const every = Math.ceil(time.length / 100);
    for (let at = 0; at <= last; at += every) {
      const line = table.tBodies[0].insertRow();
      cell(line, "td", time[at].toFixed(3));
      for (const [panel, side] of columns) cell(line, "td", interval(side, at, panel.factor));
    }
  });

  const resized = new ResizeObserver(() => {
    charts.forEach((chart, n) => chart.setSize({ width: find(`chart-${panels[n].id}`).clientWidth, height: HEIGHT }));
    drawBody(); mark();
  });
  document.querySelectorAll("main, #picture").forEach((each) => resized.observe(each));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { drawCharts(); drawBody(); });
  drawCharts();
  show(nearest(0));
})();
