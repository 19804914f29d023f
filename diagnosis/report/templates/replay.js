
(() => {
  "use strict";
  const all = () => document.querySelectorAll("details.print");
  let closed = [];
  addEventListener("beforeprint", () => {
    closed = [...all()].filter((fold) => !fold.open);
    closed.forEach((fold) => { fold.open = true; });
  });
  addEventListener("afterprint", () => closed.forEach((fold) => { fold.open = false; }));

  const block = document.getElementById("replay-data");
  if (!block) return;
  const data = JSON.parse(block.textContent);
  const find = (id) => document.getElementById(id);
  const slider = find("replay-slider"), button = find("replay-play"), speed = find("replay-speed");
  const sides = ["nominal", "corrected"].filter((name) => name in data);
  const last = data.time.length - 1;
  let row = data.start, playing = false, before = 0, clock = 0;

  const chain = (tips) => tips.some((tip) => tip.includes(null)) ? ""
    : "M" + [data.base, ...tips].map((p) => p.join(" ")).join("L");
  const marks = (points) => points.filter((p) => !p.includes(null)).map((p) => `M${p[0]} ${p[1]}h.1`).join("");
  const distance = (value) => value === null ? "–" : (value / 10).toFixed(1);

  function show(next) {
    row = next;
    for (const name of sides) {
      find(`replay-${name}`).setAttribute("d", chain(data[name][row]));
      find(`replay-off-${name}`).textContent = distance(data.off[name][row]);
    }
    find("replay-observed").setAttribute("d", marks(data.observed[row]));
    find("replay-time").textContent = data.time[row].toFixed(2);
    slider.value = row;
    slider.setAttribute("aria-valuetext", `${data.time[row].toFixed(2)} seconds`);
    const cursor = find("replay-cursor");
    cursor.style.left = `${last ? 100 * data.time[row] / data.time[last] : 0}%`;
  }

  function step(now) {
    if (!playing) return;
    clock += (now - before) / 1000 * Number(speed.value);
    before = now;
    if (clock > data.time[last]) clock = 0;
    let next = clock < data.time[row] ? 0 : row;
    while (next < last && data.time[next + 1] <= clock) next += 1;
    if (next !== row) show(next);
    requestAnimationFrame(step);
  }

  function play(on) {
    playing = on;
    button.textContent = on ? "Pause" : "Play";
    if (on) {
      clock = row === last ? 0 : data.time[row];
      before = performance.now();
      requestAnimationFrame(step);
    }
  }

  button.addEventListener("click", () => play(!playing));
  slider.addEventListener("input", () => { play(false); show(Number(slider.value)); });
  addEventListener("beforeprint", () => play(false));
  find("replay-controls").hidden = false;
  show(row);
})();
