"use strict";
// Shows the motions that the page carries. It simulates nothing: poses come from the simulators, and between two of them
// only the drawing is interpolated. Lengths are in m, z up; times in s.
(function () {
  const scenarios = JSON.parse(document.getElementById("scenarios").textContent);
  const byId = (id) => document.getElementById(id);
  const [select, source, iterate, landscape, stage, play, time, speed, said] =
    ["scenario", "source", "iterate", "landscape", "motion", "play", "time", "speed", "said"].map(byId);
  const POINT = "point";
  const state = { scenario: null, poses: null, width: 0, motion: 0, seconds: 0, playing: false, last: null };

  // --- Data -----------------------------------------------------------------------------------------------------------

  // Of each motion the first pose and then differences: see packed.py.
  async function unpack(scenario) {
    const bytes = Uint8Array.from(atob(scenario.motions), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const view = new DataView(await new Response(stream).arrayBuffer());
    const frames = scenario.seconds.length;
    const width = view.byteLength / 2 / scenario.setpoints.length / frames;
    const poses = new Float64Array(view.byteLength / 2);
    for (let i = 0; i < poses.length; i++) {
      const isFirst = Math.floor(i / width) % frames === 0;
      poses[i] = (isFirst ? 0 : poses[i - width]) + view.getInt16(2 * i, true);
    }
    return { poses: poses.map((whole) => whole * scenario.quantum), width };
  }

  // The pose [x, z, theta, finger x, finger z, ...] at a time, between two frames where need be.
  function poseAt(seconds) {
    const times = state.scenario.seconds, frames = times.length;
    let k = 0;
    while (k < frames - 2 && times[k + 1] <= seconds) k++;
    const share = Math.min(1, Math.max(0, (seconds - times[k]) / (times[k + 1] - times[k])));
    const at = (state.motion * frames + k) * state.width;
    return Array.from({ length: state.width }, (_, i) =>
      state.poses[at + i] * (1 - share) + state.poses[at + state.width + i] * share);
  }

  // --- Drawing --------------------------------------------------------------------------------------------------------

  function add(parent, name, attributes, text) {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    return parent.appendChild(element);
  }

  // The landscape is drawn in a square of 100, with room for the axes.
  const toSquare = ([x, z]) => {
    const [[x0, x1], [z0, z1]] = state.scenario.window;
    return [100 * (x - x0) / (x1 - x0), 100 - 100 * (z - z0) / (z1 - z0)];
  };
  const fromSquare = ([a, b]) => {
    const [[x0, x1], [z0, z1]] = state.scenario.window;
    return [x0 + (x1 - x0) * a / 100, z0 + (z1 - z0) * (100 - b) / 100];
  };

  function drawLandscape() {
    const scenario = state.scenario;
    landscape.replaceChildren();
    landscape.setAttribute("viewBox", "-18 -4 123 122");
    add(landscape, "image", { href: scenario.landscape, width: 100, height: 100, preserveAspectRatio: "none",
      style: "image-rendering: pixelated" });
    scenario.window.forEach(([low, high], axis) => {
      for (const share of [0, 0.25, 0.5, 0.75, 1]) {
        const label = (low + (high - low) * share).toFixed(2);
        const place = axis === 0 ? { x: 100 * share, y: 106, "text-anchor": "middle" }
          : { x: -2, y: 101.5 - 100 * share, "text-anchor": "end" };
        add(landscape, "text", { ...place, "font-size": 4 }, label);
      }
    });
    const whose = scenario.setpoints[0].length > 2 ? " of the left finger" : "";
    add(landscape, "text", { x: 50, y: 113, "font-size": 4.5, "text-anchor": "middle" }, `setpoint x${whose} (m)`);
    add(landscape, "text", { transform: "translate(-14 50) rotate(-90)", "font-size": 4.5, "text-anchor": "middle" },
      `setpoint z${whose} (m)`);
    const clip = add(add(landscape, "clipPath", { id: "inside" }), "rect", { width: 100, height: 100 });
    clip.setAttribute("x", 0);
    const paths = add(landscape, "g", { "clip-path": "url(#inside)" });
    const looks = { exact: { stroke: "#ffffff" }, stochastic: { stroke: "#ff9a5c", "stroke-dasharray": "2 1" } };
    for (const [method, path] of Object.entries(scenario.paths)) {
      const points = path.iterations.map((_, i) => toSquare(scenario.setpoints[path.first + i]).join(",")).join(" ");
      add(paths, "polyline", { points, fill: "none", "stroke-width": 0.8, ...looks[method] });
    }
    state.cursor = add(landscape, "g", {});
    add(state.cursor, "circle", { r: 2.6, fill: "none", stroke: "#000000", "stroke-width": 1.8 });
    add(state.cursor, "circle", { r: 2.6, fill: "none", stroke: "#ffffff", "stroke-width": 0.8 });
  }

  function drawStage() {
    const { view, half, radius, setpoints } = state.scenario;
    const [x0, x1, z0, z1] = view;
    stage.replaceChildren();
    stage.setAttribute("viewBox", `${x0} ${-z1} ${x1 - x0} ${z1 - z0}`);
    const up = add(stage, "g", { transform: "scale(1 -1)" });
    add(up, "rect", { x: x0 - 10, y: -10, width: x1 - x0 + 20, height: 10, fill: "#737880" });
    state.tracks = Array.from({ length: setpoints[0].length / 2 }, () =>
      add(up, "polyline", { class: "track", "stroke-width": 0.012 }));
    state.box = add(up, "g", { id: "box" });
    const [a, b] = half;
    add(state.box, "rect", { x: -a, y: -b, width: 2 * a, height: 2 * b, fill: "#5999cc", stroke: "#284459",
      "stroke-width": 0.01 });
    add(state.box, "path", { d: `M0 ${-0.2 * b} V${0.5 * b} M${-0.2 * a} ${0.3 * b} L0 ${0.5 * b} L${0.2 * a} ${0.3 * b}`,
      fill: "none", stroke: "#1a2640", "stroke-width": 0.03 });
    state.fingers = state.tracks.map(() => add(up, "circle", { r: Math.max(radius, 0.02), fill: "#d65e00",
      stroke: "#5f2a00", "stroke-width": 0.008 }));
    state.marks = state.tracks.map(() => add(up, "path", { class: "setpoint", d: "M-0.035 0 H0.035 M0 -0.035 V0.035",
      "stroke-width": 0.018 }));
  }

  function drawMotion() {
    const frames = state.scenario.seconds.length, setpoint = state.scenario.setpoints[state.motion];
    state.tracks.forEach((track, f) => {
      const at = (k) => (state.motion * frames + k) * state.width + 3 + 2 * f;
      track.setAttribute("points", Array.from({ length: frames }, (_, k) =>
        `${state.poses[at(k)]},${state.poses[at(k) + 1]}`).join(" "));
      state.marks[f].setAttribute("transform", `translate(${setpoint[2 * f]} ${setpoint[2 * f + 1]})`);
    });
    const at = toSquare(setpoint), inside = at.map((number) => Math.min(100, Math.max(0, number)));
    state.isOutside = at.some((number, i) => number !== inside[i]);
    state.cursor.setAttribute("transform", `translate(${inside.join(" ")})`);
    drawPose();
  }

  function drawPose() {
    const pose = poseAt(state.seconds);
    state.box.setAttribute("transform", `translate(${pose[0]} ${pose[1]}) rotate(${pose[2] * 180 / Math.PI})`);
    state.fingers.forEach((finger, f) =>
      finger.setAttribute("transform", `translate(${pose[3 + 2 * f]} ${pose[4 + 2 * f]})`));
    time.setAttribute("aria-valuetext", `${state.seconds.toFixed(3)} seconds`);
    say();
  }

  function say() {
    const scenario = state.scenario, cost = scenario.costs[state.motion], pose = poseAt(state.seconds);
    const where = scenario.setpoints[state.motion].map((number) => number.toFixed(3)).join(", ");
    said.textContent = `${scenario.task} on ${scenario.simulator}, setpoint (${where}) m: `
      + `J = ${cost === null ? "not finite" : cost.toFixed(4)}${state.isOutside ? ", outside the landscape" : ""}. `
      + `At ${state.seconds.toFixed(2)} s the box is at x = ${pose[0].toFixed(2)} m, z = ${pose[1].toFixed(2)} m, `
      + `turned by ${(pose[2] * 180 / Math.PI).toFixed(0)} degrees.`;
  }

  // --- Choosing -------------------------------------------------------------------------------------------------------

  function show(motion) {
    state.motion = motion;
    drawMotion();
  }

  // Points of the window are the first motions, x first.
  function pick([x, z]) {
    const { window: [[x0, x1], [z0, z1]], grid } = state.scenario;
    const index = (value, low, high) =>
      Math.min(grid - 1, Math.max(0, Math.round((value - low) / (high - low) * (grid - 1))));
    source.value = POINT;
    byId("iterate-label").hidden = true;
    show(index(z, z0, z1) * grid + index(x, x0, x1));
  }

  function chooseSource() {
    const path = state.scenario.paths[source.value];
    byId("iterate-label").hidden = !path;
    if (!path) return pick(state.scenario.setpoints[state.motion]);
    iterate.max = path.iterations.length - 1;
    iterate.value = path.iterations.reduce((best, iteration, i) =>
      Math.abs(iteration - path.best) < Math.abs(path.iterations[best] - path.best) ? i : best, 0);
    chooseIterate();
  }

  function chooseIterate() {
    const path = state.scenario.paths[source.value];
    iterate.setAttribute("aria-valuetext", `iterate ${path.iterations[iterate.value]}`);
    show(path.first + Number(iterate.value));
  }

  async function chooseScenario() {
    const scenario = scenarios[select.value];
    const unpacked = await unpack(scenario);
    Object.assign(state, { scenario, ...unpacked });
    source.replaceChildren(new Option("a point of the landscape", POINT),
      ...Object.keys(scenario.paths).map((method) => new Option(`${method} descent`, method)));
    time.max = scenario.seconds.length - 1;
    setTime(0);
    drawLandscape();
    drawStage();
    source.value = Object.keys(scenario.paths)[0] || POINT;
    chooseSource();
    document.body.dataset.ready = select.value;
  }

  // --- Time -----------------------------------------------------------------------------------------------------------

  const end = () => state.scenario.seconds[state.scenario.seconds.length - 1];

  function setTime(seconds) {
    state.seconds = seconds;
    time.value = state.scenario.seconds.findLastIndex((t) => t <= seconds + 1e-9);
  }

  function setPlaying(playing) {
    state.playing = playing;
    state.last = null;
    play.textContent = playing ? "Pause" : "Play";
    said.setAttribute("aria-live", playing ? "off" : "polite");  // Nobody is read sixty sentences a second.
    if (playing) {
      if (state.seconds >= end()) setTime(0);
      requestAnimationFrame(advance);
    } else {
      say();
    }
  }

  function advance(now) {
    if (!state.playing) return;
    const passed = state.last === null ? 0 : (now - state.last) / 1000;
    state.last = now;
    setTime(Math.min(end(), state.seconds + passed * Number(speed.value)));
    drawPose();
    if (state.seconds >= end()) setPlaying(false);
    else requestAnimationFrame(advance);
  }

  // --- Events ---------------------------------------------------------------------------------------------------------

  landscape.addEventListener("click", (event) => {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(landscape.getScreenCTM().inverse());
    pick(fromSquare([point.x, point.y]));
  });
  landscape.addEventListener("keydown", (event) => {
    const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
    if (!move) return;
    event.preventDefault();
    const { window: [[x0, x1], [z0, z1]], grid, setpoints } = state.scenario;
    const [x, z] = setpoints[state.motion];
    pick([x + move[0] * (x1 - x0) / (grid - 1), z + move[1] * (z1 - z0) / (grid - 1)]);
  });
  select.addEventListener("change", chooseScenario);
  source.addEventListener("change", chooseSource);
  iterate.addEventListener("input", chooseIterate);
  play.addEventListener("click", () => setPlaying(!state.playing));
  time.addEventListener("input", () => {
    if (state.playing) setPlaying(false);
    state.seconds = state.scenario.seconds[time.value];
    drawPose();
  });

  select.replaceChildren(...scenarios.map((scenario, i) => new Option(`${scenario.task} on ${scenario.simulator}`, i)));
  chooseScenario();
})();
