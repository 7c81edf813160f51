"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const INK = { truth: "#787e88", estimate: "#1f5ac8", hit: "#d63c3c", beam: "rgba(120,170,240,.2)", landmark: "#b01830",
    door: "#e08c00", goal: "#148c5a", place: "#7864be", mover: "#7846a0", solid: "#464d5a", free: "#fff", unseen: "#e0e3e7",
    ink: "#262c36", faint: "#8c929c", polygon: "#c2187a" };
  const DECISION_INK = [INK.estimate, INK.door, INK.goal, INK.faint]; // landmark, track, new, ignored
  const CHI2_95 = Math.sqrt(5.991), NEES_BAND = [0.216, 9.348]; // 95 % of a chi-square of 3 degrees of freedom

  function fail(words) {
    $("trouble").textContent = words;
    $("trouble").hidden = false;
  }

  async function unpack() {
    const bytes = Uint8Array.from(atob($("run").textContent.trim()), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return JSON.parse(await new Response(stream).text());
  }

  // Landmarks and cells are written as changes: bring them into a form in which every frame can be drawn alone.
  function expand(run) {
    let rows = new Map(), last = {};
    for (const frame of run.frames) {
      if (frame.landmarks) {
        rows = new Map(rows);
        for (const row of frame.landmarks) row.length === 1 ? rows.delete(row[0]) : rows.set(row[0], row);
      }
      frame.known = rows;
      for (const name of ["corners", "polygons", "matched", "goals", "moving"]) frame[name] = frame[name] || [];
      last = frame;
    }
    return last;
  }

  class Grid {
    constructor(run) {
      this.run = run;
      [this.width, this.height] = run.grid.size;
      this.canvas = Object.assign(document.createElement("canvas"), { width: this.width, height: this.height });
      this.context = this.canvas.getContext("2d");
      this.image = this.context.createImageData(this.width, this.height);
      const light = (c) => c.map((v) => Math.round(0.2 * v + 0.8 * 255));
      this.colours = [[224, 227, 231], [70, 77, 90], [243, 203, 140], [255, 255, 255], ...run.rooms.map(light)];
      this.at = -1;
    }
    show(index) { // the map of a frame; going back begins anew, which takes milliseconds
      if (index < this.at || this.at < 0) {
        for (let i = 0; i < this.width * this.height; i++) this.paint(i, 0);
        this.at = -1;
      }
      for (let k = this.at + 1; k <= index; k++) {
        const cells = this.run.frames[k].cells || [];
        for (let i = 0; i < cells.length; i += 3) for (let j = 0; j < cells[i + 1]; j++) this.paint(cells[i] + j, cells[i + 2]);
      }
      this.at = index;
      this.context.putImageData(this.image, 0, 0);
    }
    paint(cell, code) {
      const row = this.height - 1 - Math.floor(cell / this.width), at = 4 * (row * this.width + (cell % this.width));
      this.image.data.set(this.colours[code], at);
      this.image.data[at + 3] = 255;
    }
  }

  // A canvas that shows metres (y up) and finds what is under the pointer.
  class View {
    constructor(id, bounds) {
      this.canvas = $(id);
      this.bounds = bounds;
      this.targets = [];
    }
    resize() { // `begin` then sees another width
      this.width = 0;
    }
    begin() { // an empty picture; true when its size is a new one
      if (this.width) {
        this.pen.clearRect(0, 0, this.width, this.height);
        this.targets = [];
        return false;
      }
      const [x0, y0, x1, y1] = this.bounds, width = this.canvas.clientWidth, ratio = window.devicePixelRatio || 1;
      const height = Math.max(160, Math.min(width * (y1 - y0) / (x1 - x0), 0.62 * window.innerHeight));
      this.canvas.style.height = height + "px";
      [this.width, this.height] = [width, height];
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
      this.scale = Math.min(width / (x1 - x0), height / (y1 - y0));
      this.left = 0.5 * (width - this.scale * (x1 - x0)) - this.scale * x0;
      this.top = 0.5 * (height - this.scale * (y1 - y0)) + this.scale * y1;
      this.pen = this.canvas.getContext("2d");
      this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      this.pen.lineJoin = "round";
      this.targets = [];
      return true;
    }
    px([x, y]) { return [this.left + this.scale * x, this.top - this.scale * y]; }
    trace(points, closed) {
      this.pen.beginPath();
      points.forEach((p, i) => { const [x, y] = this.px(p); i ? this.pen.lineTo(x, y) : this.pen.moveTo(x, y); });
      if (closed) this.pen.closePath();
    }
    line(points, colour, width = 1.5, dash = []) {
      if (points.length < 2) return;
      this.trace(points, false);
      Object.assign(this.pen, { strokeStyle: colour, lineWidth: width });
      this.pen.setLineDash(dash);
      this.pen.stroke();
      this.pen.setLineDash([]);
    }
    area(points, fill, stroke, width = 1) {
      this.trace(points, true);
      if (fill) { this.pen.fillStyle = fill; this.pen.fill(); }
      if (stroke) { Object.assign(this.pen, { strokeStyle: stroke, lineWidth: width }); this.pen.stroke(); }
    }
    dot(point, radius, colour, hollow = 0) {
      const [x, y] = this.px(point);
      this.pen.beginPath();
      this.pen.arc(x, y, radius, 0, 2 * Math.PI);
      if (hollow) { Object.assign(this.pen, { strokeStyle: colour, lineWidth: hollow }); this.pen.stroke(); }
      else { this.pen.fillStyle = colour; this.pen.fill(); }
    }
    specks(points, half, colour) { // many small squares, which are far faster than discs
      this.pen.fillStyle = colour;
      for (const point of points) { const [x, y] = this.px(point); this.pen.fillRect(x - half, y - half, 2 * half, 2 * half); }
    }
    square(point, half, colour, hollow) {
      const [x, y] = this.px(point), box = [x - half, y - half, 2 * half, 2 * half];
      if (hollow) { Object.assign(this.pen, { strokeStyle: colour, lineWidth: hollow }); this.pen.strokeRect(...box); }
      else { this.pen.fillStyle = colour; this.pen.fillRect(...box); }
    }
    ellipse(point, [xx, xy, yy], magnified, turn, colour) { // covariance in m^2, turned into the frame of this view
      const half = 0.5 * (xx + yy), d = Math.hypot(0.5 * (xx - yy), xy), angle = 0.5 * Math.atan2(2 * xy, xx - yy) + turn;
      const axes = [half + d, Math.max(half - d, 0)].map((v) => Math.max(0.5, magnified * CHI2_95 * Math.sqrt(v) * this.scale));
      const [x, y] = this.px(point);
      this.pen.beginPath();
      this.pen.ellipse(x, y, axes[0], axes[1], -angle, 0, 2 * Math.PI);
      Object.assign(this.pen, { strokeStyle: colour, lineWidth: 1 });
      this.pen.stroke();
    }
    text(words, point, colour, size = 12, align = "center") {
      const [x, y] = this.px(point);
      Object.assign(this.pen, { font: `${size}px system-ui, sans-serif`, textAlign: align, textBaseline: "middle" });
      Object.assign(this.pen, { strokeStyle: "#ffffffcc", lineWidth: 3, fillStyle: colour });
      this.pen.strokeText(words, x, y);
      this.pen.fillText(words, x, y);
    }
    robot([x, y, heading], radius, colour) {
      const r = Math.max(radius, 5 / this.scale), nose = [x + r * Math.cos(heading), y + r * Math.sin(heading)];
      this.dot([x, y], r * this.scale, colour);
      this.line([[x, y], nose], "#fff", 2);
    }
    target(point, words) { this.targets.push([this.px(point), words]); }
    under(x, y) {
      let best = null, least = 14;
      for (const [[px, py], words] of this.targets) {
        const off = Math.hypot(px - x, py - y);
        if (off < least) { least = off; best = words; }
      }
      return best;
    }
  }

  const metres = ([x, y]) => [x / 100, y / 100];
  const posed = ([x, y, h]) => [x / 100, y / 100, h / 1000];
  const at = ([px, py, h], [x, y]) => [px + Math.cos(h) * x - Math.sin(h) * y, py + Math.sin(h) * x + Math.cos(h) * y];
  const onto = (a, b) => [...at(a, b), a[2] + b[2]];

  function start(run) {
    expand(run);
    const frames = run.frames, count = frames.length, grid = new Grid(run), hasTruth = run.walls.length > 0;
    const inWorld = posed(run.map_in_world), laser = posed(run.laser), cell = run.grid.cell, origin = metres(run.grid.origin);
    const toWorld = (p) => at(inWorld, p), mapPoint = (row) => toWorld(metres([row[1], row[2]]));
    const walls = run.walls.map((ring) => ring.map(metres));
    const bounds = extent(hasTruth ? walls.flat() : [origin, [origin[0] + cell * run.grid.size[0], origin[1] + cell * run.grid.size[1]]].map(toWorld));
    const world = new View("world", bounds), belief = new View("belief", bounds);
    const pathTrue = frames.map((f) => f.truth && metres(f.truth)), pathMap = frames.map((f) => toWorld(metres(f.pose)));
    const marks = events(run), magnifyAll = fitted(run);
    let index = 0, playing = false, since = 0, drawn = 0;

    function scan(view, pose, fan) {
      const from = onto(pose, laser), ends = [], hits = [];
      (frames[index].ranges || []).forEach((range, i) => {
        const bearing = run.bearings[i] / 1000, r = range / 100;
        if (range) { const end = at(from, [r * Math.cos(bearing), r * Math.sin(bearing)]); ends.push(end); hits.push(end); }
        else ends.push([from[0], from[1]]);
      });
      if (fan && ends.length) view.area([[from[0], from[1]], ...ends], INK.beam);
      view.specks(hits, 1.2, INK.hit);
      return from;
    }

    function drawWorld(frame) {
      if (world.begin() || !plan.width) drawPlan();
      world.pen.drawImage(plan, 0, 0, world.width, world.height);
      const pose = posed(frame.truth);
      world.line(pathTrue.slice(0, index + 1), INK.truth);
      scan(world, pose, true);
      for (const ring of frame.moving) world.area(ring.map(metres), INK.mover);
      world.robot(pose, run.robot_cm / 100, INK.ink);
      $("world-note").textContent = "(hidden from the robot)";
    }

    const plan = Object.assign(document.createElement("canvas"), { width: 0 });
    function drawPlan() { // the walls, which never change
      for (const ring of walls) world.area(ring, null, INK.solid, 5);
      walls.forEach((ring, i) => world.area(ring, run.solid[i] ? INK.solid : INK.free));
      [plan.width, plan.height] = [world.canvas.width, world.canvas.height];
      plan.getContext("2d").drawImage(world.canvas, 0, 0);
    }

    function drawBelief(frame) {
      belief.begin();
      const map = run.maps[frame.map || 0], pose = onto(inWorld, posed(frame.pose)), turn = inWorld[2];
      const magnified = Number($("magnify").value) || magnifyAll;
      drawGrid();
      for (const [room, ...ids] of map.polygons) {
        const ring = ids.map((id) => frame.known.get(id)).filter(Boolean).map(mapPoint);
        if (ring.length === ids.length) belief.area(ring, tint(room, 0.1), tint(room, 0.5));
      }
      for (const ids of map.doors) if (ids.every((id) => frame.known.has(id))) belief.line(ids.map((id) => mapPoint(frame.known.get(id))), INK.door, 3.5);
      for (const gap of map.gaps) belief.line(gap.map((p) => toWorld(metres(p))), INK.door, 1.5, [4, 3]);
      belief.line(pathMap.slice(0, index + 1), INK.estimate);
      const from = scan(belief, pose, false);
      drawRecognised(frame, from);
      const places = [];
      for (const row of frame.known.values()) {
        const point = mapPoint(row);
        belief.ellipse(point, row.slice(3).map((v) => v / 1e6), magnified, turn, INK.landmark + "99");
        places.push(point);
        const sigma = Math.sqrt(Math.max(row[3], row[5])) / 10;
        belief.target(point, `landmark ${row[0]}: sigma ${sigma.toFixed(1)} cm`);
      }
      belief.specks(places, 1.8, INK.landmark);
      drawCorners(frame, from);
      drawGoals(frame);
      for (const [room, spot] of labels(frame, map)) belief.text(`room ${room}`, spot, tint(room, 1), 13);
      belief.ellipse(pose, frame.cov.map((v) => v / 1e6), magnified, turn, INK.estimate);
      belief.robot(pose, run.robot_cm / 100, frame.lost ? INK.hit : INK.estimate);
      if (frame.lost) belief.text("pose is searched for", [pose[0], pose[1] + 26 / belief.scale], INK.hit, 14);
      if (frame.truth) belief.dot(metres(frame.truth), 3, INK.ink, 1.5);
    }

    function drawGrid() {
      grid.show(index);
      const pen = belief.pen, [x, y] = belief.px(toWorld([origin[0], origin[1] + cell * grid.height])), s = belief.scale * cell;
      pen.save();
      pen.imageSmoothingQuality = "high"; // cells are seldom parallel to the picture: no saw-tooth walls
      pen.translate(x, y);
      pen.rotate(-inWorld[2]);
      pen.drawImage(grid.canvas, 0, 0, grid.width * s, grid.height * s);
      pen.restore();
    }

    function drawRecognised(frame, from) { // the scan's polygons; the one that was recognised, with that of the map
      (frame.polygons || []).forEach((ring, i) => {
        const points = ring.map((p) => at(from, metres(p))), chosen = i === frame.chosen && frame.matched.length;
        belief.area(points, chosen ? "#c2187a22" : null, chosen ? INK.polygon : "#8c929c", chosen ? 2 : 1);
      });
      const known = frame.matched.map((id) => frame.known.get(id)).filter(Boolean).map(mapPoint);
      if (known.length > 2) belief.area(known, null, INK.polygon, 1);
      if (known.length > 2) for (const p of known) belief.square(p, 5, INK.polygon, 1.5);
    }

    function drawCorners(frame, from) {
      for (const [x, y, n1, n2, nis, kind, convex, decision, reason, id, first, firstId] of frame.corners) {
        const point = at(from, metres([x, y])), known = frame.known.get(id), ink = DECISION_INK[decision];
        for (const n of [n1, n2]) if (n !== null) belief.line([point, at([...point, from[2] + n / 1000], [10 / belief.scale, 0])], ink, 1.5);
        if (known && decision === 0) belief.line([point, mapPoint(known)], ink, 1.5);
        belief.dot(point, 4.5, ink, 2);
        belief.target(point, corner({ nis, kind, convex, decision, reason, id, first, firstId }));
      }
    }

    function corner(c) {
      const named = c.decision === 0 ? `landmark ${c.id}` : c.decision === 1 ? `track ${c.id}` : run.decisions[c.decision];
      const before = c.first !== c.decision ? `; the associator said ${c.first < 2 ? run.decisions[c.first] + " " + c.firstId : run.decisions[c.first]}` : "";
      const fit = c.nis === null ? "" : `, NIS ${(c.nis / 100).toFixed(1)}`;
      return `${["crossing", "free end", "door post"][c.kind]}, ${c.convex ? "outer" : "inner"} corner: ${named}${fit} - ${run.reasons[c.reason]}${before}`;
    }

    function drawGoals(frame) {
      frame.goals.forEach(([x, y, kind, path, size, sigma, gain], i) => {
        const p = toWorld(metres([x, y])), chosen = i === frame.target;
        kind >= 4 ? belief.square(p, chosen ? 6 : 4, INK.place, chosen ? 0 : 1.5) : belief.dot(p, chosen ? 6 : 4, INK.goal, chosen ? 0 : 1.5);
        if (chosen) belief.line([toWorld(metres(frame.pose)), p], INK.goal, 1, [2, 4]);
        const foreseen = sigma ? `, predicted sigma ${sigma} cm, gain ${(gain / 100).toFixed(2)} nat` : "";
        belief.target(p, `goal in row ${i}, ${run.kinds[kind]}: path ${(path / 100).toFixed(1)} m, opening ${(size / 100).toFixed(1)} m${foreseen}${chosen ? " - the robot drives there" : ""}`);
      });
    }

    function labels(frame, map) { // the middle of the largest polygon of each room
      const best = new Map();
      for (const [room, ...ids] of map.polygons) {
        const ring = ids.map((id) => frame.known.get(id)).filter(Boolean).map(mapPoint);
        if (ring.length < 3) continue;
        const size = Math.abs(ring.reduce((sum, [x, y], i) => { const [u, v] = ring[(i + 1) % ring.length]; return sum + x * v - u * y; }, 0));
        const middle = [0, 1].map((k) => ring.reduce((sum, p) => sum + p[k], 0) / ring.length);
        if (!best.has(room) || size > best.get(room)[0]) best.set(room, [size, middle]);
      }
      return [...best].map(([room, [, middle]]) => [room, middle]);
    }

    const tint = (room, share) => `rgba(${(run.rooms[((room % run.rooms.length) + run.rooms.length) % run.rooms.length] || [140, 146, 156]).join()},${share})`;

    function drawMarks() {
      const canvas = $("marks"), ratio = window.devicePixelRatio || 1, pen = canvas.getContext("2d");
      canvas.width = canvas.clientWidth * ratio;
      canvas.height = 9 * ratio;
      for (const [k, colour] of marks) {
        pen.fillStyle = colour;
        pen.fillRect((8 + (canvas.clientWidth - 16) * k / Math.max(count - 1, 1)) * ratio - ratio, 0, 2 * ratio, 9 * ratio);
      }
    }

    function decide(frame) {
      const words = run.decisions.length ? run.decisions : Object.values(run.decisions), seen = [0, 0, 0, 0];
      for (const c of frame.corners) seen[c[7]] += 1;
      const parts = seen.map((n, i) => n && `${n} ${words[i]}${n > 1 && i < 2 ? "s" : ""}`).filter(Boolean);
      const polygon = frame.matched.length ? `The polygon of ${frame.matched.length} corners is recognised: landmarks ${frame.matched.join(", ")}.`
        : frame.polygons.length ? `${frame.polygons.length} polygon${frame.polygons.length > 1 ? "s" : ""} around the robot, none recognised.` : "No polygon around the robot.";
      const why = [...new Set(frame.corners.filter((c) => c[7] > 1).map((c) => run.reasons[c[8]]))];
      const sigma = Math.sqrt(Math.max(frame.cov[0], frame.cov[2])) / 10, room = frame.room >= 0 ? `room ${frame.room}` : "no room";
      const state = frame.lost ? "The pose is searched for; nothing is mapped." : `In ${room}, position sigma ${sigma.toFixed(1)} cm, heading ${(frame.turn_sigma / 17.4533).toFixed(2)} deg.`;
      $("decision").innerHTML = "";
      for (const [head, text] of [["Scan", `${frame.corners.length} corners: ${parts.join(", ") || "none"}${why.length ? ` (${why.join("; ")})` : ""}.`], ["Polygon", polygon], ["Pose", state]]) {
        const row = document.createElement("div"), bold = document.createElement("b");
        bold.textContent = head + "  ";
        row.append(bold, text);
        $("decision").append(row);
      }
    }

    const plots = makePlots(run, (k) => go(k));

    function go(to, keep = true) {
      index = Math.max(0, Math.min(count - 1, Math.round(to)));
      const frame = frames[index], seconds = frame.time / 100;
      if (hasTruth) drawWorld(frame);
      drawBelief(frame);
      decide(frame);
      $("slider").value = index;
      $("clock").textContent = `${seconds.toFixed(1)} s, step ${frame.step} of ${frames[count - 1].step}`;
      for (const plot of plots) plot.cursor(index);
      drawn += 1;
      document.body.dataset.drawn = drawn;
      if (keep && !playing) remember(seconds);
    }

    let later = 0;
    function remember(seconds) { // in the address, once the moment stays
      clearTimeout(later);
      later = setTimeout(() => { try { history.replaceState(null, "", `#t=${seconds.toFixed(1)}`); } catch { /* it may not: no matter */ } }, 250);
    }

    function advance(now) {
      if (!playing) return;
      const perSecond = Number($("speed").value) * (count - 1) / Math.max(0.01 * (frames[count - 1].time - frames[0].time), 0.01);
      const to = begun + (now - since) / 1000 * perSecond;
      if (Math.floor(to) !== index) go(Math.min(Math.floor(to), count - 1), false);
      if (index >= count - 1) play(false);
      else requestAnimationFrame(advance);
    }
    let begun = 0;
    function play(on) {
      playing = on;
      $("play").textContent = on ? "Pause" : "Play";
      if (on) {
        begun = index >= count - 1 ? 0 : index;
        since = performance.now();
        requestAnimationFrame(advance);
      } else remember(frames[index].time / 100);
    }
    const stepBy = (by) => { play(false); go(index + by); };

    $("result").textContent = run.result;
    $("slider").max = count - 1;
    $("stage").classList.toggle("alone", !hasTruth);
    for (const id of ["stage", "controls", "thinking", "curves", "help"]) $(id).hidden = false;
    if (!hasTruth) world.canvas.parentElement.hidden = true;
    $("trouble").hidden = true;
    $("play").onclick = () => play(!playing);
    $("slider").oninput = () => { play(false); go(Number($("slider").value)); };
    $("speed").onchange = () => { if (playing) play(true); };
    $("magnify").onchange = () => go(index);
    $("magnify").options[0].textContent = `x${magnifyAll}`;
    for (const button of document.querySelectorAll(".step")) button.onclick = () => stepBy(Number(button.dataset.by));
    document.onkeydown = (event) => {
      if (event.target.tagName === "SELECT" || event.ctrlKey || event.metaKey || event.altKey) return;
      const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (event.key === " ") play(!playing);
      else if (by) stepBy(by * (event.shiftKey ? 10 : 1));
      else if (event.key === "Home") stepBy(-count);
      else if (event.key === "End") stepBy(count);
      else return;
      event.preventDefault();
    };
    const tip = Object.assign(document.createElement("div"), { id: "tip", hidden: true });
    document.body.append(tip);
    belief.canvas.onmousemove = belief.canvas.onclick = (event) => {
      const words = belief.under(event.offsetX, event.offsetY);
      tip.hidden = !words;
      tip.textContent = words || "";
      tip.style.left = Math.min(event.clientX + 14, window.innerWidth - 340) + "px";
      tip.style.top = event.clientY + 16 + "px";
    };
    belief.canvas.onmouseleave = () => { tip.hidden = true; };
    window.onresize = () => {
      if (!belief.canvas.clientWidth) return; // while the page is hidden
      world.resize(); belief.resize(); drawMarks(); for (const plot of plots) plot.resize(); go(index, false);
    };
    const jump = () => {
      const t = /^#t=([\d.]+)$/.exec(location.hash);
      go(t ? frames.reduce((best, f, i) => Math.abs(f.time / 100 - t[1]) < Math.abs(frames[best].time / 100 - t[1]) ? i : best, 0) : run.opens_at, false);
    };
    window.onhashchange = () => { play(false); jump(); };
    legend();
    drawMarks();
    for (const plot of plots) plot.resize();
    jump();
    if (location.hash === "#play") { go(0, false); play(true); }
  }

  function legend() {
    const dot = (c, hollow) => `border-radius:50%;${hollow ? `border:2px solid ${c}` : `background:${c}`}`;
    const items = [["corner that is a landmark", dot(INK.estimate, 1)], ["on a track", dot(INK.door, 1)], ["new", dot(INK.goal, 1)],
      ["ignored", dot(INK.faint, 1)], ["landmark, 95 %", dot(INK.landmark)], ["recognised polygon", `border:2px solid ${INK.polygon}`],
      ["door", `background:${INK.door};height:4px;vertical-align:3px`], ["goal", dot(INK.goal)], ["known ground", `border:2px solid ${INK.place}`],
      ["true place", dot(INK.ink, 1)], ["scan", dot(INK.hit)]];
    for (const [words, style] of items) {
      const item = document.createElement("li"), patch = document.createElement("i");
      patch.style.cssText = style;
      item.append(patch, words);
      $("legend").append(item);
    }
  }

  function extent(points) {
    let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const [x, y] of points) { x0 = Math.min(x0, x); y0 = Math.min(y0, y); x1 = Math.max(x1, x); y1 = Math.max(y1, y); }
    return [x0 - 0.4, y0 - 0.4, x1 + 0.4, y1 + 0.4];
  }

  function fitted(run) { // a scale at which the ellipse of a usual landmark has a radius of 0.3 m
    const rows = [...run.frames[run.frames.length - 1].known.values()].map((r) => Math.sqrt(Math.max(r[3], r[5])) / 1000).sort((a, b) => a - b);
    const usual = rows.length ? rows[rows.length >> 1] : 0.01;
    return [1, 2, 3, 5, 10, 20, 30, 50].reduce((best, k) => k * usual * CHI2_95 <= 0.3 ? k : best, 1);
  }

  function events(run) { // moments worth a look, for the slider: [frame, colour]
    const found = [], last = new Map();
    run.frames.forEach((frame, k) => {
      const before = run.frames[k - 1];
      if (before && !!frame.lost !== !!before.lost) found.push([k, INK.hit]);
      if (before && (frame.curves.doors_found || 0) > (before.curves.doors_found || 0)) found.push([k, INK.door]);
      const seen = frame.corners.filter((c) => c[7] === 0).map((c) => c[9]);
      if (seen.filter((id) => last.has(id) && frame.step - last.get(id) > 150).length > 1) found.push([k, INK.polygon]);
      for (const id of seen) last.set(id, frame.step);
    });
    return found;
  }

  function makePlots(run, go) {
    const frames = run.frames, unit = run.curve_units, curve = (name) => frames.map((f) => name in f.curves ? f.curves[name] / unit[name] : NaN);
    const error = frames.map((f) => "pose_error_m" in f.curves ? f.curves.pose_error_m / unit.pose_error_m * 100 : NaN);
    const sigma3 = frames.map((f) => 3 * Math.sqrt(Math.max(f.cov[0], f.cov[2])) / 10);
    const rewards = Object.keys(unit).filter((name) => name.startsWith("reward_"))
      .map((name) => [name, Math.max(...curve(name).map((v) => Math.abs(v) || 0))]).filter(([, most]) => most)
      .sort((a, b) => b[1] - a[1]).slice(0, 5).map(([name]) => name);
    const share = (name) => curve(name).map((v) => 100 * v), any = (values) => values.some((v) => Number.isFinite(v));
    const inks = [INK.estimate, INK.door, INK.goal, INK.polygon, INK.place];
    const all = [
      ["Position, cm", [["error", error, INK.hit], ["3 sigma", sigma3, INK.faint]]],
      ["NEES of the pose, 95 % band", [["NEES", curve("nees"), INK.estimate]], { log: true, band: NEES_BAND }],
      ["Coverage, %", [["correct coverage", share("correct_coverage"), INK.goal], ["coverage", share("coverage"), INK.faint]]],
      ["Landmarks", [["landmarks", any(curve("landmarks")) ? curve("landmarks") : frames.map((f) => f.known.size), INK.landmark]]],
      ["Reward, summed", rewards.map((name, i) => [name.slice(7).replaceAll("_", " "), curve(name), inks[i]])],
      ["Confidence", [["confidence", frames.map((f) => f.confidence / 1000), INK.estimate]]],
    ];
    return all.map(([title, lines, options]) => [title, lines.filter(([, values]) => any(values)), options || {}])
      .filter(([, lines]) => lines.length).map((parts) => new Plot(...parts, frames.length, go));
  }

  class Plot {
    constructor(title, lines, options, count, go) {
      Object.assign(this, { lines, options, count, left: 40, canvas: document.createElement("canvas") });
      const box = document.createElement("div"), head = document.createElement("div"), name = document.createElement("b");
      this.line = document.createElement("i");
      name.textContent = title;
      head.append(name);
      this.values = lines.map(([words, , ink]) => {
        const value = document.createElement("span");
        value.style.color = ink;
        head.append(value);
        return [words, value];
      });
      box.className = "plot";
      box.append(head, this.canvas, this.line);
      $("curves").append(box);
      const pick = (event) => go((event.offsetX - this.left) / (this.width - this.left - 8) * (count - 1));
      this.canvas.onpointerdown = (event) => { this.canvas.setPointerCapture(event.pointerId); pick(event); };
      this.canvas.onpointermove = (event) => { if (event.buttons) pick(event); };
      const values = lines.flatMap(([, v]) => v.filter(Number.isFinite)), f = options.log ? (v) => Math.log10(Math.max(v, 0.02)) : (v) => v;
      this.f = f;
      const reach = [...values].sort((a, b) => a - b), high = reach[Math.floor(0.998 * (reach.length - 1))];
      this.low = options.log ? f(0.05) : Math.min(0, reach[0]);
      this.high = options.log ? Math.max(f(30), f(high)) : Math.max(high, this.low + 1e-6) * 1.08;
    }
    x(k) { return this.left + (this.width - this.left - 8) * k / Math.max(this.count - 1, 1); }
    resize() {
      const ratio = window.devicePixelRatio || 1, height = 108, pen = this.canvas.getContext("2d"), top = 4, bottom = height - 8;
      this.width = this.canvas.clientWidth;
      [this.canvas.width, this.canvas.height] = [this.width * ratio, height * ratio];
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      const y = (v) => bottom - (bottom - top) * (Math.min(Math.max(this.f(v), this.low), this.high) - this.low) / (this.high - this.low);
      if (this.options.band) {
        pen.fillStyle = "#1f5ac81a";
        pen.fillRect(this.left, y(this.options.band[1]), this.width - this.left - 8, y(this.options.band[0]) - y(this.options.band[1]));
      }
      Object.assign(pen, { font: "11px system-ui, sans-serif", fillStyle: INK.faint, textAlign: "right", textBaseline: "middle" });
      for (const tick of this.ticks()) {
        pen.fillText(String(tick), this.left - 5, y(tick));
        Object.assign(pen, { strokeStyle: "#eceef1", lineWidth: 1 });
        pen.beginPath(); pen.moveTo(this.left, y(tick)); pen.lineTo(this.width - 8, y(tick)); pen.stroke();
      }
      for (const [, values, ink] of this.lines) {
        pen.beginPath();
        let gap = true;
        values.forEach((v, k) => { if (!Number.isFinite(v)) { gap = true; return; } gap ? pen.moveTo(this.x(k), y(v)) : pen.lineTo(this.x(k), y(v)); gap = false; });
        Object.assign(pen, { strokeStyle: ink, lineWidth: 1.5 });
        pen.stroke();
      }
    }
    cursor(k) {
      this.line.style.transform = `translateX(${this.x(k)}px)`;
      this.values.forEach(([name, value], i) => {
        const v = this.lines[i][1][k];
        value.textContent = `${name} ${Number.isFinite(v) ? (Math.abs(v) < 10 ? v.toFixed(2) : v.toFixed(0)) : "-"}`;
      });
    }
    ticks() {
      if (this.options.log) return [0.1, 1, 10, 100].filter((v) => this.f(v) < this.high);
      const rough = (this.high - this.low) / 3, power = 10 ** Math.floor(Math.log10(rough)), step = [1, 2, 5, 10].find((k) => k * power >= rough) * power;
      const first = Math.ceil(this.low / step - 1e-9);
      return Array.from({ length: 6 }, (_, i) => Number(((first + i) * step).toPrecision(6))).filter((v) => v <= this.high);
    }
  }

  if (!document.createElement("canvas").getContext) fail("This browser cannot draw (no canvas). Open the page in a current Firefox, Chromium or Safari.");
  else if (typeof DecompressionStream === "undefined") fail("This browser cannot unpack the run. Open the page in a current Firefox (113), Chromium (80) or Safari (16.4), or a later one.");
  else unpack().then(start).catch((error) => { console.error(error); fail(`The run in this page cannot be played: ${error.message}. Run the command that made it again.`); });
})();
