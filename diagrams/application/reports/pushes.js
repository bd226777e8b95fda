"use strict";
(function () {
  const all = JSON.parse(document.getElementById("report-data").textContent);
  const data = all.pushes;
  const root = document.getElementById("pushes");
  const NS = "http://www.w3.org/2000/svg";
  const INK = "#222222", FAINT = "#c9c5bb", FINGER = "#d4691e", PAPER = "#f6f4ef";
  const COLOURS = ["#1f6fb4", "#2f8f6b"];
  let chosen = 0, sample = 0, timer = null;

  function element(name, attributes, parent) {
    const made = document.createElementNS(NS, name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    if (parent) parent.appendChild(made);
    return made;
  }
  // The picture's y axis points down, the table's up: y is negated once, here.
  const pair = (p) => p[0].toFixed(5) + "," + (-p[1]).toFixed(5);
  const line = (points) => points.map(pair).join(" ");
  function place(point, pose) {
    const c = Math.cos(pose[2]), s = Math.sin(pose[2]);
    return [pose[0] + c * point[0] - s * point[1], pose[1] + s * point[0] + c * point[1]];
  }
  const rings = (pose) =>
    data.outline.map((ring) => "M" + ring.map((p) => pair(place(p, pose))).join("L") + "Z").join("");
  const track = (poses) => poses.map((pose) => place(data.centroid, pose));
  function box(points, margin) {
    let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity;
    for (const p of points) {
      x0 = Math.min(x0, p[0]); x1 = Math.max(x1, p[0]); y0 = Math.min(y0, p[1]); y1 = Math.max(y1, p[1]);
    }
    const size = Math.max(x1 - x0, y1 - y0) * (1 + 2 * margin);
    // A little more room below, for the scale bar.
    return { x: (x0 + x1 - size) / 2, y: -(y0 + y1 + size) / 2 + 0.03 * size, size: size };
  }
  function frame(svg, view) {
    svg.setAttribute("viewBox", [view.x, view.y, view.size, view.size].join(" "));
    svg.replaceChildren();
  }
  function scaleBar(svg, view) {
    const power = Math.pow(10, Math.floor(Math.log10(view.size / 4)));
    const length = power * [5, 2, 1].find((step) => step * power <= view.size / 4);
    const x = view.x + 0.04 * view.size, y = view.y + 0.95 * view.size;
    element("path", { d: `M${x},${y}h${length}`, stroke: INK, "stroke-width": 0.006 * view.size }, svg);
    const text = element("text", { x: x + length + 0.015 * view.size, y: y + 0.012 * view.size,
      "font-size": 0.034 * view.size, fill: INK }, svg);
    text.textContent = (length * 1000).toFixed(0) + " mm";
  }

  // Map of all pushes.
  const map = root.querySelector(".map"), traces = [];
  function drawMap() {
    const points = [];
    for (const push of data.pushes) {
      for (const poses of [push.measured, ...push.predicted]) for (const p of track(poses)) points.push(p);
    }
    const view = box(points, 0.09), thin = 0.004 * view.size;
    frame(map, view);
    if (data.table) {
      const t = data.table, style = { fill: PAPER, stroke: FAINT, "stroke-width": thin / 2 };
      if (t.shape === "round") {
        element("circle", { cx: t.center[0], cy: -t.center[1], r: t.radius, ...style }, map);
      } else {
        element("rect", { x: t.center[0] - t.size[0] / 2, y: -t.center[1] - t.size[1] / 2, width: t.size[0],
          height: t.size[1], ...style }, map);
      }
    }
    data.pushes.forEach((push, index) => {
      // Between only two measured poses nothing is known: dashes.
      const dash = push.times.length === 2 ? [2.5 * thin, 2 * thin].join(" ") : "none";
      const group = element("g", { "stroke-dasharray": dash, "stroke-linecap": "round", "stroke-linejoin": "round", fill: "none" }, map);
      element("polyline", { points: line(track(push.measured)), stroke: INK, "stroke-width": thin }, group);
      push.predicted.forEach((poses, k) =>
        element("polyline", { points: line(track(poses)), stroke: COLOURS[k], "stroke-width": thin }, group));
      const start = track(push.measured)[0];
      element("circle", { cx: start[0], cy: -start[1], r: 1.3 * thin, fill: INK, stroke: "none" }, group);
      // A wide invisible line is easier to hit with the pointer.
      const area = element("polyline", { points: line(track(push.measured)), stroke: "transparent",
        "stroke-width": 7 * thin, "pointer-events": "stroke", style: "cursor:pointer" }, group);
      area.addEventListener("mouseenter", () => near(index));
      area.addEventListener("mouseleave", () => near(-1));
      area.addEventListener("click", () => choose(index));
      traces.push(group);
    });
    scaleBar(map, view);
  }
  function near(index) {
    const shown = index < 0 ? chosen : index;
    traces.forEach((group, k) => group.setAttribute("opacity", k === shown ? 1 : index < 0 ? 0.45 : 0.15));
    for (const row of root.querySelectorAll("tbody tr")) {
      row.classList.toggle("near", Number(row.dataset.push) === index);
    }
  }

  // One push as a film.
  const film = root.querySelector(".film"), slider = root.querySelector("input"), button = root.querySelector("button");
  const readout = root.querySelector(".readout"), heading = root.querySelector(".film-title");
  let moving = null;
  function choose(index) {
    stop();
    chosen = index;
    const push = data.pushes[index];
    heading.textContent = "Push " + push.name + ", " + push.role;
    const points = [];
    for (const poses of [push.measured, ...push.predicted]) {
      for (const pose of [poses[0], poses[poses.length - 1]]) {
        for (const p of data.outline[0]) points.push(place(p, pose));
      }
    }
    for (const p of push.finger) if (p) points.push(p);
    const view = box(points, 0.1), thin = 0.0045 * view.size;
    frame(film, view);
    element("path", { d: rings(push.measured[0]), fill: PAPER, stroke: FAINT, "stroke-width": thin / 2,
      "fill-rule": "evenodd" }, film);
    element("polyline", { points: line(track(push.measured)), fill: "none", stroke: INK, "stroke-width": thin / 2 }, film);
    const path = push.finger.filter((p) => p);
    if (path.length) {
      element("polyline", { points: line(path), fill: "none", stroke: FINGER, "stroke-width": thin / 2,
        "stroke-dasharray": [2 * thin, 2 * thin].join(" ") }, film);
    }
    const shapes = push.predicted.map((poses, k) => {
      element("polyline", { points: line(track(poses)), fill: "none", stroke: COLOURS[k], "stroke-width": thin / 2 }, film);
      return element("path", { fill: COLOURS[k], "fill-opacity": 0.1, stroke: COLOURS[k], "stroke-width": thin,
        "stroke-dasharray": k ? [3 * thin, 2 * thin].join(" ") : "none", "fill-rule": "evenodd" }, film);
    });
    const measured = element("path", { fill: "none", stroke: INK, "stroke-width": thin }, film);
    const finger = element("circle", { r: data.radius, fill: FINGER, "fill-opacity": 0.85 }, film);
    scaleBar(film, view);
    moving = { measured, shapes, finger, cursor: drawCourse(push) };
    slider.max = push.times.length - 1;
    for (const row of root.querySelectorAll("tbody tr")) {
      row.classList.toggle("chosen", Number(row.dataset.push) === index);
    }
    near(-1);
    show(push.times.length - 1);
  }
  // Error over time, with a line at the moment shown.
  const course = root.querySelector(".course");
  function drawCourse(push) {
    const wide = Math.max(320, course.clientWidth || 1000), high = 96, left = 52, foot = 18;
    course.setAttribute("viewBox", `0 0 ${wide} ${high}`);
    course.replaceChildren();
    const end = push.times[push.times.length - 1];
    const top = 1.08 * Math.max(...push.add.flat(), data.floor || 0, 1e-6);
    const x = (t) => left + (wide - left - 8) * t / end, y = (add) => high - foot - (high - foot - 6) * add / top;
    const text = (words, px, py, anchor) => {
      element("text", { x: px, y: py, "font-size": 12, fill: "#6a6a68", "text-anchor": anchor }, course).textContent = words;
    };
    element("path", { d: `M${left},4V${high - foot}H${wide - 8}`, fill: "none", stroke: "#9a9a9a" }, course);
    const most = 1000 * top / 1.08;
    text((most < 10 ? most.toPrecision(2) : most.toFixed(0)) + " mm", left - 5, y(top / 1.08) + 4, "end");
    text("0", left - 5, y(0) + 4, "end");
    text("error (ADD)", left + 6, 14, "start");
    text(end.toFixed(1) + " s", wide - 8, high - 4, "end");
    if (data.floor) {
      element("path", { d: `M${left},${y(data.floor)}H${wide - 8}`, stroke: INK, "stroke-dasharray": "4 3", fill: "none" }, course);
    }
    push.add.forEach((values, k) => {
      const points = values.map((add, i) => [x(push.times[i]), y(add)]);
      if (points.length === 2) {
        element("circle", { cx: points[1][0], cy: points[1][1], r: 4, fill: COLOURS[k] }, course);
      } else {
        element("polyline", { fill: "none", stroke: COLOURS[k], "stroke-width": 2, points: points.join(" ") }, course);
      }
    });
    const cursor = element("path", { stroke: FINGER, "stroke-width": 1.5 }, course);
    return (t) => cursor.setAttribute("d", `M${x(t)},4V${high - foot}`);
  }
  function show(index) {
    sample = index;
    slider.value = index;
    const push = data.pushes[chosen];
    moving.measured.setAttribute("d", rings(push.measured[index]));
    moving.shapes.forEach((shape, k) => shape.setAttribute("d", rings(push.predicted[k][index])));
    const tip = push.finger[index];
    moving.finger.setAttribute("visibility", tip ? "visible" : "hidden");
    if (tip) {
      moving.finger.setAttribute("cx", tip[0]);
      moving.finger.setAttribute("cy", -tip[1]);
    }
    const off = push.add.map((values, k) => data.labels[k] + " " + (1000 * values[index]).toFixed(2) + " mm");
    moving.cursor(push.times[index]);
    readout.textContent = "t = " + push.times[index].toFixed(2) + " s.  Error (ADD): " + off.join(", ") + "."
      + (push.times.length === 2 ? " Only the first and the last pose were measured." : "");
  }
  function stop() {
    if (timer !== null) clearTimeout(timer);
    timer = null;
    button.textContent = "Play";
  }
  function step() {
    const push = data.pushes[chosen];
    if (sample >= push.times.length - 1) { stop(); return; }
    const wait = 1000 * (push.times[sample + 1] - push.times[sample]);
    timer = setTimeout(() => { show(sample + 1); step(); }, Math.max(16, wait));
  }
  button.addEventListener("click", () => {
    if (timer !== null) { stop(); return; }
    if (sample >= data.pushes[chosen].times.length - 1) show(0);
    button.textContent = "Pause";
    step();
  });
  slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });

  // Table: click a heading to sort, a row to choose.
  const body = root.querySelector("tbody"), heads = [...root.querySelectorAll("tr.sort th")];
  heads.forEach((head, column) => head.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") { event.preventDefault(); head.click(); }
  }));
  heads.forEach((head, column) => head.addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") === "descending" ? 1 : head.getAttribute("aria-sort") ? -1 : column < 2 ? 1 : -1;
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up > 0 ? "ascending" : "descending");
    const key = (row) => {
      const cell = row.cells[column], value = cell.dataset.value;
      return value === undefined ? cell.textContent : value === "" ? NaN : Number(value);
    };
    const rows = [...body.rows].sort((a, b) => {
      const x = key(a), y = key(b);
      if (typeof x === "number" && typeof y === "number") {
        if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
        return up * (x - y);
      }
      return up * String(x).localeCompare(String(y));
    });
    body.replaceChildren(...rows);
  }));
  for (const row of body.rows) {
    const index = Number(row.dataset.push);
    row.addEventListener("click", () => choose(index));
    row.addEventListener("mouseenter", () => near(index));
    row.addEventListener("mouseleave", () => near(-1));
    row.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); choose(index); }
    });
  }

  drawMap();
  choose(data.first);
  // Otherwise its letters would scale with the window.
  new ResizeObserver(() => {
    moving.cursor = drawCourse(data.pushes[chosen]);
    moving.cursor(data.pushes[chosen].times[sample]);
  }).observe(course);
})();
