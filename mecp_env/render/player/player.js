"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const INK = {}; // name -> colour, of the properties of the style sheet: `readInks`
  const DECISIONS = [["estimate", "circle"], ["door", "triangle"], ["goal", "diamond"], ["quiet", "cross"]]; // landmark, track, new, ignored
  const EVENTS = { door: ["door", "triangle"], loop: ["polygon", "diamond"], lost: ["hit", "cross"] };
  const ROOM_TINT = 0.2, ROOM_VEIL = 0.16; // of a room's colour in its cells, and in its polygons on top of them
  const UNKNOWN = 0, OCCUPIED = 1; // codes of cells
  const REACH = 3; // cells around a wall cell that say where its wall is
  const KNOWN_GROUND = 4; // goals from this kind on
  const CHI2_95 = Math.sqrt(5.991), NEES_BAND = [0.216, 9.348]; // 95 % of a chi-square of 3 degrees of freedom

  function fail(words) {
    $("trouble").textContent = words;
    $("trouble").hidden = false;
  }

  function readInks() { // again when the theme changes
    const style = getComputedStyle(document.documentElement);
    for (const name of ["ink", "paper", "panel", "faint", "line", "accent", "unseen", "free", "solid", "truth", "estimate", "hit", "beam", "band",
      "landmark", "door", "goal", "place", "mover", "polygon", "quiet"]) INK[name] = style.getPropertyValue("--" + name).trim();
  }
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
  const mixed = (colour, other, share) => colour.map((v, i) => Math.round(share * v + (1 - share) * other[i]));
  const css = (colour) => `rgb(${colour.join()})`;

  // Outlines of marks, about as large as a circle of radius 1; a mark is known by its shape, not by its colour alone.
  const turned = (count, radius, from = -0.5 * Math.PI) => Array.from({ length: count }, (_, i) => {
    const angle = from + 2 * Math.PI * i / count, r = radius[i % radius.length];
    return [r * Math.cos(angle), r * Math.sin(angle)];
  });
  const SHAPES = { circle: [turned(24, [1])], triangle: [turned(3, [1.3])], diamond: [turned(4, [1.3])], square: [turned(4, [1.25], 0.25 * Math.PI)],
    star: [turned(10, [1.5, 0.65])], hexagon: [turned(6, [1.15])], cross: [[[-0.9, -0.9], [0.9, 0.9]], [[-0.9, 0.9], [0.9, -0.9]]],
    line: [[[-1.3, 0], [1.3, 0]]] };
  const OPEN = ["cross", "line"];
  function stamp(pen, [x, y], shape, radius, ink, hollow = 0) {
    pen.beginPath();
    for (const points of SHAPES[shape]) {
      points.forEach(([u, v], i) => i ? pen.lineTo(x + radius * u, y + radius * v) : pen.moveTo(x + radius * u, y + radius * v));
      if (!OPEN.includes(shape)) pen.closePath();
    }
    if (hollow || OPEN.includes(shape)) { Object.assign(pen, { strokeStyle: INK[ink], lineWidth: hollow || 2 }); pen.stroke(); }
    else { pen.fillStyle = INK[ink]; pen.fill(); }
  }
  function symbol(shape, ink, { hollow = false, width = 1.8, dash = [] } = {}) { // the same mark as an element of the page
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), path = document.createElementNS(svg.namespaceURI, "path");
    const wide = shape === "line" ? 22 : 14, scale = shape === "line" ? 8 : 4.4, open = OPEN.includes(shape);
    const d = SHAPES[shape].map((points) => "M" + points.map(([u, v]) => `${(wide / 2 + scale * u).toFixed(1)} ${(7 + scale * v).toFixed(1)}`).join("L") + (open ? "" : "Z"));
    for (const [name, value] of Object.entries({ width: wide, height: 14, "aria-hidden": true })) svg.setAttribute(name, value);
    path.setAttribute("d", d.join(""));
    path.style.cssText = `stroke:var(--${ink});stroke-width:${width};stroke-dasharray:${dash.join(" ") || "none"};fill:${hollow || open ? "none" : `var(--${ink})`}`;
    svg.append(path);
    return svg;
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

  class Grid { // the semantic grid as a picture of its cells, and its walls as lines
    constructor(run) {
      this.run = run;
      [this.width, this.height] = run.grid.size;
      this.canvas = Object.assign(document.createElement("canvas"), { width: this.width, height: this.height });
      this.context = this.canvas.getContext("2d");
      this.image = this.context.createImageData(this.width, this.height);
      this.codes = new Uint8Array(this.width * this.height);
      this.wallCells = new Set();
      this.places = new Map(); // of the wall cells on their walls, as far as they are known
      this.theme();
    }
    theme() {
      const free = rgb(INK.free), unseen = rgb(INK.unseen);
      this.colours = [unseen, unseen, mixed(rgb(INK.door), free, 0.35), free, ...this.run.rooms.map((c) => mixed(c, free, ROOM_TINT))];
      this.at = -1;
    }
    show(index) { // the map of a frame; going back begins again, which takes milliseconds
      if (index === this.at) return;
      if (index < this.at || this.at < 0) this.clear();
      const changed = new Set();
      for (let k = this.at + 1; k <= index; k++) {
        const cells = this.run.frames[k].cells || [];
        for (let i = 0; i < cells.length; i += 3) for (let j = 0; j < cells[i + 1]; j++) this.set(cells[i] + j, cells[i + 2], changed);
      }
      this.at = index;
      if (!changed.size && this.walls) return;
      for (const cell of changed) for (const step of [0, 1, -1, this.width, -this.width]) this.paint(cell + step);
      this.context.putImageData(this.image, 0, 0);
      this.walls = this.wallLines();
    }
    clear() {
      this.codes.fill(UNKNOWN);
      this.wallCells.clear();
      this.places.clear();
      for (let cell = 0; cell < this.codes.length; cell++) this.paint(cell);
      this.at = -1;
      this.walls = null;
    }
    set(cell, code, changed) {
      if (this.codes[cell] === code) return;
      if (this.codes[cell] === OCCUPIED || code === OCCUPIED) {
        for (let y = -REACH; y <= REACH; y++) for (let x = -REACH; x <= REACH; x++) this.places.delete(cell + y * this.width + x);
        code === OCCUPIED ? this.wallCells.add(cell) : this.wallCells.delete(cell);
      }
      this.codes[cell] = code;
      changed.add(cell);
    }
    middles(rooms, colours) { // for each room that has cells of its colour, the one of them that is nearest to their mean
      return rooms.map((room) => {
        const cells = [], code = 4 + room % colours;
        for (let i = 0; i < this.codes.length; i++) if (this.codes[i] === code) cells.push([i % this.width + 0.5, Math.floor(i / this.width) + 0.5]);
        const mean = [0, 1].map((k) => cells.reduce((sum, p) => sum + p[k], 0) / cells.length), off = ([x, y]) => Math.hypot(x - mean[0], y - mean[1]);
        return [room, cells.reduce((best, p) => best && off(best) <= off(p) ? best : p, null)];
      }).filter(([, place]) => place);
    }
    shown(cell) { // what is painted: below a wall, the floor next to it
      const code = this.codes[cell];
      return code !== OCCUPIED ? code : [1, -1, this.width, -this.width].map((step) => this.codes[cell + step]).find((beside) => beside > OCCUPIED) || UNKNOWN;
    }
    paint(cell) {
      if (cell < 0 || cell >= this.codes.length) return;
      const row = this.height - 1 - Math.floor(cell / this.width), at = 4 * (row * this.width + (cell % this.width));
      const colour = this.colours[this.shown(cell)], data = this.image.data;
      data[at] = colour[0]; data[at + 1] = colour[1]; data[at + 2] = colour[2]; data[at + 3] = 255;
    }
    occupied(x, y) { return x >= 0 && y >= 0 && x < this.width && y < this.height && this.codes[y * this.width + x] === OCCUPIED; }
    wallLines() { // pairs of points in cells: from each occupied cell to its neighbours, each moved onto the line of its wall
      const lines = [], place = (x, y) => {
        const cell = y * this.width + x;
        if (!this.places.has(cell)) this.places.set(cell, this.onWall(x, y));
        return this.places.get(cell);
      };
      for (const cell of this.wallCells) {
        const x = cell % this.width, y = Math.floor(cell / this.width), right = this.occupied(x + 1, y), up = this.occupied(x, y + 1);
        if (right) lines.push([place(x, y), place(x + 1, y)]);
        if (up) lines.push([place(x, y), place(x, y + 1)]);
        if (!right && !up && this.occupied(x + 1, y + 1)) lines.push([place(x, y), place(x + 1, y + 1)]);
        if (!up && !this.occupied(x - 1, y) && this.occupied(x - 1, y + 1)) lines.push([place(x, y), place(x - 1, y + 1)]);
      }
      return lines;
    }
    onWall(x, y) { // the middle of a cell, projected onto the line through the occupied cells around it, where they form one
      let [n, sx, sy, xx, xy, yy] = [0, 0, 0, 0, 0, 0];
      for (let j = -REACH; j <= REACH; j++) for (let i = -REACH; i <= REACH; i++) {
        if (!this.occupied(x + i, y + j)) continue;
        n += 1; sx += i; sy += j; xx += i * i; xy += i * j; yy += j * j;
      }
      const [mx, my] = [sx / n, sy / n], [cxx, cxy, cyy] = [xx / n - mx * mx, xy / n - mx * my, yy / n - my * my];
      const half = 0.5 * (cxx + cyy), d = Math.hypot(0.5 * (cxx - cyy), cxy), angle = 0.5 * Math.atan2(2 * cxy, cxx - cyy);
      if (half - d > 0.2 * (half + d)) return [x + 0.5, y + 0.5]; // a corner, or a block
      const off = mx * Math.sin(angle) - my * Math.cos(angle);
      return [x + 0.5 + off * Math.sin(angle), y + 0.5 - off * Math.cos(angle)];
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
    veil(rings, share) { // translucent areas that grow no darker where they overlap: opaque on a layer of their own
      this.layer = this.layer || document.createElement("canvas");
      [this.layer.width, this.layer.height] = [this.canvas.width, this.canvas.height];
      const picture = this.pen;
      this.pen = this.layer.getContext("2d");
      this.pen.setTransform(picture.getTransform());
      for (const [ring, colour] of rings) this.area(ring, colour);
      this.pen = picture;
      this.pen.globalAlpha = share;
      this.pen.drawImage(this.layer, 0, 0, this.width, this.height);
      this.pen.globalAlpha = 1;
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
    mark(point, shape, radius, ink, hollow = 0) { stamp(this.pen, this.px(point), shape, radius, ink, hollow); }
    ellipse(point, [xx, xy, yy], magnified, turn, colour) { // covariance in m^2, turned into the frame of this view
      const half = 0.5 * (xx + yy), d = Math.hypot(0.5 * (xx - yy), xy), angle = 0.5 * Math.atan2(2 * xy, xx - yy) + turn;
      const axes = [half + d, Math.max(half - d, 0)].map((v) => Math.max(0.5, magnified * CHI2_95 * Math.sqrt(v) * this.scale));
      const [x, y] = this.px(point);
      this.pen.beginPath();
      this.pen.ellipse(x, y, axes[0], axes[1], -angle, 0, 2 * Math.PI);
      Object.assign(this.pen, { strokeStyle: colour, lineWidth: 1 });
      this.pen.stroke();
    }
    text(words, point, colour, size = 13) { this.words(words, ...this.px(point), colour, size); }
    words(words, x, y, colour, size) { // on a halo, readable on any room
      Object.assign(this.pen, { font: `600 ${size}px system-ui, sans-serif`, textAlign: "center", textBaseline: "middle" });
      Object.assign(this.pen, { strokeStyle: INK.panel, lineWidth: 4, fillStyle: colour });
      this.pen.strokeText(words, x, y);
      this.pen.fillText(words, x, y);
    }
    scaleBar() { // at the lower left corner
      const length = [50, 20, 10, 5, 2].find((m) => m * this.scale < 0.15 * this.width) || 1, y = this.height - 8, right = 10 + length * this.scale;
      for (const [ink, width, out] of [[INK.panel, 6, 2], [INK.ink, 2, 0]]) {
        Object.assign(this.pen, { strokeStyle: ink, lineWidth: width });
        this.pen.beginPath(); this.pen.moveTo(10 - out, y); this.pen.lineTo(right + out, y); this.pen.stroke();
      }
      this.words(`${length} m`, 0.5 * (10 + right), y - 11, INK.ink, 12);
    }
    robot([x, y, heading], radius, colour) {
      const r = Math.max(radius, 5 / this.scale), nose = [x + r * Math.cos(heading), y + r * Math.sin(heading)];
      this.dot([x, y], r * this.scale, colour);
      this.line([[x, y], nose], INK.panel, 2);
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
    const marks = events(run), magnifyAll = fitted(run), roomInk = (room) => run.rooms[((room % run.rooms.length) + run.rooms.length) % run.rooms.length] || rgb(INK.quiet);
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
      world.scaleBar();
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
      drawRooms(frame, map);
      drawWalls();
      for (const ids of map.doors) if (ids.every((id) => frame.known.has(id))) belief.line(ids.map((id) => mapPoint(frame.known.get(id))), INK.door, 3.5);
      for (const gap of map.gaps) belief.line(gap.map((p) => toWorld(metres(p))), INK.door, 1.5, [4, 3]);
      belief.line(pathMap.slice(0, index + 1), INK.estimate);
      const from = scan(belief, pose, false);
      drawRecognised(frame, from);
      const places = [];
      for (const row of frame.known.values()) {
        const point = mapPoint(row);
        belief.ellipse(point, row.slice(3).map((v) => v / 1e6), magnified, turn, INK.landmark);
        places.push(point);
        const sigma = Math.sqrt(Math.max(row[3], row[5])) / 10;
        belief.target(point, `landmark ${row[0]}: sigma ${sigma.toFixed(1)} cm`);
      }
      for (const point of places) belief.mark(point, "circle", 2.4, "landmark");
      drawCorners(frame, from);
      drawGoals(frame);
      for (const [room, spot] of labels(frame, map)) belief.text(`room ${room}`, spot, INK.ink);
      belief.ellipse(pose, frame.cov.map((v) => v / 1e6), magnified, turn, INK.estimate);
      belief.robot(pose, run.robot_cm / 100, frame.lost ? INK.hit : INK.estimate);
      if (frame.lost) belief.text("pose is searched for", [pose[0], pose[1] + 26 / belief.scale], INK.hit, 14);
      if (frame.truth) belief.mark(metres(frame.truth), "circle", 3, "ink", 1.5);
      belief.scaleBar();
    }

    function drawRooms(frame, map) { // the polygons of the rooms, the largest first
      const rings = map.polygons.map(([room, ...ids]) => [ids.map((id) => frame.known.get(id)).filter(Boolean).map(mapPoint), roomInk(room), ids.length])
        .filter(([ring, , all]) => ring.length === all).sort((a, b) => areaOf(b[0]) - areaOf(a[0]));
      belief.veil(rings.map(([ring, colour]) => [ring, css(colour)]), ROOM_VEIL);
      for (const [ring, colour] of rings) belief.area(ring, null, css(mixed(colour, rgb(INK.free), 0.6)));
    }

    function drawWalls() { // one path, so that lines that meet are one area
      const pen = belief.pen, spot = ([x, y]) => belief.px(toWorld([origin[0] + cell * x, origin[1] + cell * y]));
      pen.beginPath();
      for (const [a, b] of grid.walls) { pen.moveTo(...spot(a)); pen.lineTo(...spot(b)); }
      Object.assign(pen, { strokeStyle: INK.solid, lineWidth: Math.max(2, cell * belief.scale), lineCap: "round" });
      pen.stroke();
      pen.lineCap = "butt";
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
        belief.area(points, null, chosen ? INK.polygon : INK.quiet, chosen ? 2.5 : 1);
      });
      const known = frame.matched.map((id) => frame.known.get(id)).filter(Boolean).map(mapPoint);
      if (known.length > 2) belief.area(known, null, INK.polygon, 1);
      if (known.length > 2) for (const p of known) belief.mark(p, "square", 5.5, "polygon", 1.5);
    }

    function drawCorners(frame, from) {
      for (const [x, y, n1, n2, nis, kind, convex, decision, reason, id, first, firstId] of frame.corners) {
        const point = at(from, metres([x, y])), known = frame.known.get(id), [ink, shape] = DECISIONS[decision];
        for (const n of [n1, n2]) if (n !== null) belief.line([point, at([...point, from[2] + n / 1000], [10 / belief.scale, 0])], INK[ink], 1.5);
        if (known && decision === 0) belief.line([point, mapPoint(known)], INK[ink], 1.5);
        belief.mark(point, shape, 4.5, ink, 2);
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
        belief.mark(p, ...(kind >= KNOWN_GROUND ? ["hexagon", chosen ? 6 : 4.5, "place"] : ["star", chosen ? 6.5 : 4.5, "goal"]), chosen ? 0 : 1.5);
        if (chosen) belief.line([toWorld(metres(frame.pose)), p], INK.goal, 1, [2, 4]);
        const foreseen = sigma ? `, predicted sigma ${sigma} cm, gain ${(gain / 100).toFixed(2)} nat` : "";
        belief.target(p, `goal in row ${i}, ${run.kinds[kind]}: path ${(path / 100).toFixed(1)} m, opening ${(size / 100).toFixed(1)} m${foreseen}${chosen ? " - the robot drives there" : ""}`);
      });
    }

    function labels(frame, map) { // the middle of the largest polygon of each room, or of its cells
      const best = new Map();
      for (const [room, ...ids] of map.polygons) {
        const ring = ids.map((id) => frame.known.get(id)).filter(Boolean).map(mapPoint);
        if (ring.length < 3) continue;
        const size = areaOf(ring);
        if (!best.has(room) || size > best.get(room)[0]) best.set(room, [size, centroid(ring)]);
      }
      const cells = grid.middles(map.rooms.filter((room) => !best.has(room)), run.rooms.length);
      return [...best].map(([room, [, middle]]) => [room, middle]).concat(cells.map(([room, [x, y]]) => [room, toWorld([origin[0] + cell * x, origin[1] + cell * y])]));
    }

    function drawMarks() {
      const canvas = $("marks"), ratio = window.devicePixelRatio || 1, pen = canvas.getContext("2d");
      canvas.width = canvas.clientWidth * ratio;
      canvas.height = 12 * ratio;
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      for (const [k, kind] of marks) stamp(pen, [8 + (canvas.clientWidth - 16) * k / Math.max(count - 1, 1), 6], EVENTS[kind][1], 4, EVENTS[kind][0]);
    }

    function decided(frame) { // three pairs of a head and a sentence
      const words = Object.values(run.decisions), seen = [0, 0, 0, 0];
      for (const c of frame.corners) seen[c[7]] += 1;
      const parts = seen.map((n, i) => n && `${n} ${words[i]}${n > 1 && i < 2 ? "s" : ""}`).filter(Boolean);
      const polygon = frame.matched.length ? `The polygon of ${frame.matched.length} corners is recognised: landmarks ${frame.matched.join(", ")}.`
        : frame.polygons.length ? `${frame.polygons.length} polygon${frame.polygons.length > 1 ? "s" : ""} around the robot, none recognised.` : "No polygon around the robot.";
      const why = [...new Set(frame.corners.filter((c) => c[7] > 1).map((c) => run.reasons[c[8]]))];
      const sigma = Math.sqrt(Math.max(frame.cov[0], frame.cov[2])) / 10, room = frame.room >= 0 ? `room ${frame.room}` : "no room";
      const state = frame.lost ? "The pose is searched for; nothing is mapped." : `In ${room}, position sigma ${sigma.toFixed(1)} cm, heading ${(frame.turn_sigma / 17.4533).toFixed(2)} deg.`;
      return [["Scan", `${frame.corners.length} corners: ${parts.join(", ") || "none"}${why.length ? ` (${why.join("; ")})` : ""}.`], ["Polygon", polygon], ["Pose", state]];
    }
    function write(sentences) {
      $("decision").textContent = "";
      for (const [head, text] of sentences) {
        const row = document.createElement("div"), bold = document.createElement("b");
        bold.textContent = head + "  ";
        row.append(bold, text);
        $("decision").append(row);
      }
    }
    // Nothing below or beside a text moves as the run plays: there is space for the longest.
    const clock = (frame) => `${(frame.time / 100).toFixed(1)} s, step ${frame.step} of ${frames[count - 1].step}`;
    const longest = frames.map(decided).reduce((best, all) => all.map((one, i) => best[i] && best[i][1].length >= one[1].length ? best[i] : one), []);
    function reserve() {
      $("decision").style.minHeight = "0";
      write(longest);
      $("decision").style.minHeight = $("decision").offsetHeight + "px";
      $("clock").style.minWidth = Math.max(...frames.map((f) => clock(f).length)) + "ch";
    }

    const plots = makePlots(run, (k) => go(k));

    function go(to, keep = true) {
      index = Math.max(0, Math.min(count - 1, Math.round(to)));
      const frame = frames[index], seconds = frame.time / 100;
      if (hasTruth) drawWorld(frame);
      drawBelief(frame);
      write(decided(frame));
      $("slider").value = index;
      $("clock").textContent = clock(frame);
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
      reserve();
      world.resize(); belief.resize(); drawMarks(); for (const plot of plots) plot.resize(); go(index, false);
    };
    matchMedia("(prefers-color-scheme: dark)").onchange = () => { readInks(); grid.theme(); plan.width = 0; window.onresize(); };
    const jump = () => {
      const t = /^#t=([\d.]+)$/.exec(location.hash);
      go(t ? frames.reduce((best, f, i) => Math.abs(f.time / 100 - t[1]) < Math.abs(frames[best].time / 100 - t[1]) ? i : best, 0) : run.opens_at, false);
    };
    window.onhashchange = () => { play(false); jump(); };
    legend(run, magnifyAll);
    reserve();
    drawMarks();
    for (const plot of plots) plot.resize();
    jump();
    if (location.hash === "#play") { go(0, false); play(true); }
  }

  function legend(run, magnified) { // of what the run shows at some time
    const some = (test) => run.frames.some(test), corner = (decision) => some((f) => f.corners.some((c) => c[7] === decision));
    const goal = (known) => some((f) => f.goals.some((g) => (g[2] >= KNOWN_GROUND) === known)), kinds = new Set(events(run).map(([, kind]) => kind));
    const maps = run.maps, hollow = { hollow: true };
    const items = [
      ...["corner matched to a landmark", "corner on a track", "new corner", "ignored corner"].map((words, i) => [corner(i), words, DECISIONS[i][1], DECISIONS[i][0], hollow]),
      [some((f) => f.known.size), `landmark; ellipse: 95 %, x${magnified} unless chosen`, "circle", "landmark"],
      [some((f) => f.matched.length), "recognised polygon, its landmarks", "square", "polygon", hollow],
      [maps.some((m) => m.doors.length), "door", "line", "door", { width: 3.5 }], [maps.some((m) => m.gaps.length), "door candidate", "line", "door", { dash: [4, 3] }],
      [goal(false), "goal, filled: chosen", "star", "goal", hollow], [goal(true), "goal on known ground", "hexagon", "place", hollow],
      [some((f) => f.moving.length), "pedestrian, box", "square", "mover"], [some((f) => f.truth), "true position", "circle", "ink", hollow],
      [some((f) => f.truth), "true path", "line", "truth"], [true, "estimated path", "line", "estimate"], [some((f) => f.ranges), "laser hit", "square", "hit"],
      [kinds.has("door"), "mark: door found", EVENTS.door[1], EVENTS.door[0]], [kinds.has("loop"), "mark: loop closed", EVENTS.loop[1], EVENTS.loop[0]],
      [kinds.has("lost"), "mark: pose lost or found", EVENTS.lost[1], EVENTS.lost[0]],
    ];
    for (const [, words, shape, ink, looks] of items.filter(([shown]) => shown)) {
      const item = document.createElement("li");
      item.append(symbol(shape, ink, looks), words);
      $("legend").append(item);
    }
  }

  function areaOf(ring) {
    return Math.abs(ring.reduce((sum, [x, y], i) => { const [u, v] = ring[(i + 1) % ring.length]; return sum + x * v - u * y; }, 0)) / 2;
  }

  function centroid(ring) { // of the area; the mean of the vertices where there is none
    let [sum, cx, cy] = [0, 0, 0];
    ring.forEach(([x, y], i) => {
      const [u, v] = ring[(i + 1) % ring.length], cross = x * v - u * y;
      sum += cross; cx += (x + u) * cross; cy += (y + v) * cross;
    });
    return Math.abs(sum) > 1e-6 ? [cx / (3 * sum), cy / (3 * sum)] : [0, 1].map((k) => ring.reduce((total, p) => total + p[k], 0) / ring.length);
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

  function events(run) { // moments worth a look, for the slider: [frame, kind]
    const found = [], last = new Map();
    run.frames.forEach((frame, k) => {
      const before = run.frames[k - 1];
      if (before && !!frame.lost !== !!before.lost) found.push([k, "lost"]);
      if (before && (frame.curves.doors_found || 0) > (before.curves.doors_found || 0)) found.push([k, "door"]);
      const seen = frame.corners.filter((c) => c[7] === 0).map((c) => c[9]);
      if (seen.filter((id) => last.has(id) && frame.step - last.get(id) > 150).length > 1) found.push([k, "loop"]);
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
    const inks = ["estimate", "door", "goal", "polygon", "place"];
    const landmarks = any(curve("landmarks")) ? curve("landmarks") : frames.map((f) => f.known.size);
    const all = [ // title with unit, lines: name, values, ink
      ["Position, cm", [["error", error, "hit"], ["3 sigma", sigma3, "truth"]]],
      ["NEES of the pose (3 expected; band: 95 %)", [["NEES", curve("nees"), "estimate"]], { log: true, band: NEES_BAND }],
      ["Floor, %", [["correct coverage", share("correct_coverage"), "goal"], ["coverage", share("coverage"), "truth"]]],
      ["On the map, count", [["landmarks", landmarks, "landmark"], ["doors", curve("doors_found"), "door"], ["rooms", curve("rooms_found"), "estimate"]], { count: true }],
      ["Reward, summed (no unit)", rewards.map((name, i) => [name.slice(7).replaceAll("_", " "), curve(name), inks[i]])],
      ["Confidence, 0 to 1", [["confidence", frames.map((f) => f.confidence / 1000), "estimate"]]],
    ];
    return all.map(([title, lines, options]) => [title, lines.filter(([, values]) => any(values)), options || {}])
      .filter(([, lines]) => lines.length).map((parts) => new Plot(...parts, frames.map((f) => f.time / 100), go));
  }

  const PLOT = { height: 128, top: 5, bottom: 104, left: 44, right: 10 }; // px
  const DASHES = [[], [5, 3], [2, 2], [8, 3, 2, 3], [1, 3]];
  class Plot {
    constructor(title, lines, options, times, go) {
      Object.assign(this, { lines, options, times, count: times.length, canvas: document.createElement("canvas") });
      const box = document.createElement("div"), head = document.createElement("div"), name = document.createElement("b");
      this.line = document.createElement("i");
      name.textContent = title;
      head.append(name);
      this.values = lines.map(([words, values, ink], i) => {
        const item = document.createElement("span"), value = document.createElement("output");
        value.style.minWidth = Math.max(...values.map((v) => this.form(v).length)) + "ch"; // the head keeps its height
        item.append(symbol("line", ink, { width: 2, dash: DASHES[i] }), words, " ", value);
        head.append(item);
        return value;
      });
      box.className = "plot";
      box.append(head, this.canvas, this.line);
      $("curves").append(box);
      const pick = (event) => go((event.offsetX - PLOT.left) / (this.width - PLOT.left - PLOT.right) * (this.count - 1));
      this.canvas.onpointerdown = (event) => { this.canvas.setPointerCapture(event.pointerId); pick(event); };
      this.canvas.onpointermove = (event) => { if (event.buttons) pick(event); };
      const values = lines.flatMap(([, v]) => v.filter(Number.isFinite)), f = options.log ? (v) => Math.log10(Math.max(v, 0.02)) : (v) => v;
      this.f = f;
      const reach = [...values].sort((a, b) => a - b), high = reach[Math.floor(0.998 * (reach.length - 1))];
      this.low = options.log ? f(0.05) : Math.min(0, reach[0]);
      this.high = options.log ? Math.max(f(30), f(high)) : Math.max(high, this.low + (options.count ? 1 : 1e-6)) * 1.08;
    }
    form(v) { return !Number.isFinite(v) ? "-" : this.options.count || Math.abs(v) >= 10 ? v.toFixed(0) : v.toFixed(2); }
    x(k) { return PLOT.left + (this.width - PLOT.left - PLOT.right) * k / Math.max(this.count - 1, 1); }
    y(v) { return PLOT.bottom - (PLOT.bottom - PLOT.top) * (Math.min(Math.max(this.f(v), this.low), this.high) - this.low) / (this.high - this.low); }
    resize() {
      const ratio = window.devicePixelRatio || 1, pen = this.canvas.getContext("2d");
      this.width = this.canvas.clientWidth;
      [this.canvas.width, this.canvas.height] = [this.width * ratio, PLOT.height * ratio];
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      if (this.options.band) {
        pen.fillStyle = INK.band;
        pen.fillRect(PLOT.left, this.y(this.options.band[1]), this.width - PLOT.left - PLOT.right, this.y(this.options.band[0]) - this.y(this.options.band[1]));
      }
      this.drawTicks(pen);
      this.lines.forEach(([, values, ink], i) => {
        pen.beginPath();
        let gap = true;
        values.forEach((v, k) => { if (!Number.isFinite(v)) { gap = true; return; } gap ? pen.moveTo(this.x(k), this.y(v)) : pen.lineTo(this.x(k), this.y(v)); gap = false; });
        Object.assign(pen, { strokeStyle: INK[ink], lineWidth: 1.5 });
        pen.setLineDash(DASHES[i]);
        pen.stroke();
        pen.setLineDash([]);
      });
    }
    drawTicks(pen) {
      Object.assign(pen, { font: "11px system-ui, sans-serif", fillStyle: INK.faint, textAlign: "right", textBaseline: "middle", strokeStyle: INK.line, lineWidth: 1 });
      for (const tick of this.ticks()) {
        pen.fillText(String(tick), PLOT.left - 5, this.y(tick));
        pen.beginPath(); pen.moveTo(PLOT.left, this.y(tick)); pen.lineTo(this.width - PLOT.right, this.y(tick)); pen.stroke();
      }
      Object.assign(pen, { textAlign: "center", textBaseline: "top" });
      const last = this.times[this.count - 1], step = nice((last - this.times[0]) / Math.max(2, this.width / 110), 0);
      for (let t = Math.ceil(this.times[0] / step) * step; t <= last; t += step) {
        pen.fillText(`${Number(t.toPrecision(6))} s`, Math.min(this.x(this.times.findIndex((v) => v >= t - 1e-6)), this.width - 18), PLOT.bottom + 6);
      }
    }
    cursor(k) {
      this.line.style.transform = `translateX(${this.x(k)}px)`;
      this.values.forEach((value, i) => { value.textContent = this.form(this.lines[i][1][k]); });
    }
    ticks() {
      if (this.options.log) return [0.1, 1, 10, 100].filter((v) => this.f(v) < this.high);
      const step = nice((this.high - this.low) / 3, this.options.count ? 1 : 0), first = Math.ceil(this.low / step - 1e-9);
      return Array.from({ length: 6 }, (_, i) => Number(((first + i) * step).toPrecision(6))).filter((v) => v <= this.high);
    }
  }

  function nice(rough, least) { // the next of 1, 2, 5, 10, 20, ...
    const power = 10 ** Math.floor(Math.log10(Math.max(rough, 1e-9)));
    return Math.max([1, 2, 5, 10].find((k) => k * power >= rough) * power, least);
  }

  readInks();
  if (!document.createElement("canvas").getContext) fail("This browser cannot draw (no canvas). Open the page in a current Firefox, Chromium or Safari.");
  else if (typeof DecompressionStream === "undefined") fail("This browser cannot unpack the run. Open the page in a current Firefox (113), Chromium (80) or Safari (16.4), or a later one.");
  else unpack().then(start).catch((error) => { console.error(error); fail(`The run in this page cannot be played: ${error.message}. Run the command that made it again.`); });
})();
