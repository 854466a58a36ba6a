// The page of `spheretrace view`: sends what the user does, shows what the server draws.
"use strict";

const element = (id) => document.getElementById(id);
const stage = element("stage"), canvas = element("picture"), handles = element("handles");
const axes = { color: "rgb", light_color: "rgb", center: "xyz", light_position: "xyz", light_direction: "xyz" };
let socket, state = null, light = 0, built = "";

// --- the connection -----------------------------------------------------------------------------

function connect() {
  socket = new WebSocket(new URL("ws", location.href.replace(/^http/, "ws")));
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => (typeof data === "string" ? show(JSON.parse(data)) : paint(data));
  socket.onclose = () => { element("status").textContent = "the program has ended"; };
}

// Messages that come faster than the screen are thinned: the newest of a kind is sent.
const waiting = new Map();

function send(message, key = null) {
  if (key === null) { flush(); return socket.send(JSON.stringify(message)); }
  if (waiting.size === 0) requestAnimationFrame(flush);
  waiting.set(key, message);
}

function flush() {
  for (const message of waiting.values()) socket.send(JSON.stringify(message));
  waiting.clear();
}

// --- what the server says -----------------------------------------------------------------------

function paint(data) {
  const [width, height] = state.size;
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const pixels = new ImageData(new Uint8ClampedArray(data), width, height);
  canvas.getContext("2d").putImageData(pixels, 0, 0);
  canvas.dataset.frame = Number(canvas.dataset.frame || 0) + 1;
}

function show(said) {
  const message = element("message");
  if (said.busy) { element("status").textContent = said.busy; return; }
  if (said.error || said.note || said.size && !said.rough) {
    message.textContent = said.error || said.note || "";
    message.className = said.error ? "error" : "";
  }
  if (!said.size) return;
  state = said;
  element("status").textContent = `${(1000 * said.seconds).toFixed(0)} ms`;
  element("scale").hidden = !said.scale;
  element("scale").dataset.most = said.scale.toPrecision(3);
  element("low").textContent = `-${said.scale.toPrecision(3)}`;
  element("high").textContent = said.scale.toPrecision(3);
  if (said.fit) element("fitted").textContent = said.fit;
  build();
  refresh();
  place();
}

// --- sliders ------------------------------------------------------------------------------------

const rows = { spheres: () => state.sphere, lights: () => light, camera: () => 0 };

// The numbers of a parameter: name, coordinate, and how they are labelled.
function numbers(name) {
  return name in axes ? [...axes[name]].map((axis, k) => [k, `${name} ${axis}`]) : [[0, name]];
}

function range(name) {
  const far = state.extent;
  const known = {
    unit: [0, 1], refraction: [1, 2.5], positive: [0, 3 * far], nonnegative: [0, 3], any: [-3 * far, 3 * far],
  }[state.ranges[name]];
  const angles = { theta: [-Math.PI, Math.PI], phi: [0, Math.PI], roll: [-Math.PI, Math.PI] };
  return angles[name] || { exponent: [0, 200], radius: [0, far], light_direction: [-1, 1] }[name] || known;
}

function build() {
  const spheres = state.values.radius.length, lights = state.handles.length;
  const now = [spheres, lights, light].join();
  if (now === built) return;
  built = now;
  light = Math.min(light, Math.max(lights - 1, 0));
  for (const [owner, names] of Object.entries(state.sliders)) {
    const box = element(owner);
    for (const old of box.querySelectorAll(".slider")) old.remove();
    const count = { spheres, lights, camera: 1 }[owner];
    for (const name of count ? names : []) {
      if (name in state.lights && !state.lights[name][light]) continue;
      for (const [column, label] of numbers(name)) box.append(slider(owner, name, column, label));
    }
  }
  options("sphere", spheres, state.sphere);
  options("light", lights, light);
  const choices = Object.values(state.sliders).flat();
  const chosen = element("parameter").value;
  element("parameter").replaceChildren(...choices.flatMap((name) =>
    numbers(name).map(([column, label]) => new Option(label, `${name}:${column}`))));
  if (chosen) element("parameter").value = chosen;
}

function options(id, count, chosen) {
  element(id).replaceChildren(...Array.from({ length: count }, (_, k) => new Option(k + 1, k)));
  element(id).value = chosen;
}

function slider(owner, name, column, label) {
  const row = document.createElement("label");
  row.className = "slider";
  const [low, high] = range(name);
  const bar = Object.assign(document.createElement("input"), { type: "range", min: low, max: high, step: "any" });
  const number = Object.assign(document.createElement("input"), { type: "number", step: "any" });
  bar.dataset.name = number.dataset.name = name;
  bar.dataset.column = number.dataset.column = column;
  bar.dataset.owner = number.dataset.owner = owner;
  number.setAttribute("aria-label", label);
  const set = (input) => {
    if (input.value === "") return;
    send({ type: "set", name, row: rows[owner](), column, value: Number(input.value) }, `set ${name} ${column}`);
  };
  bar.addEventListener("pointerdown", () => send({ type: "begin" }));
  bar.addEventListener("keydown", () => send({ type: "begin" }));
  bar.addEventListener("input", () => set(bar));
  number.addEventListener("focus", () => send({ type: "begin" }));
  number.addEventListener("change", () => set(number));
  row.append(label, bar, number);
  return row;
}

function refresh() {
  for (const input of document.querySelectorAll(".slider input")) {
    if (input === document.activeElement && input.type === "number" && !state.error) continue;
    const { name, column, owner } = input.dataset;
    let value = state.values[name];
    for (const k of [rows[owner](), Number(column)]) if (Array.isArray(value)) value = value[k];
    input.value = input.type === "number" ? Number(value.toPrecision(6)) : value;
  }
  element("sphere").value = state.sphere;
  element("kind").value = state.kind;
  element("kind").options[2].disabled = !state.target;
  element("parameter").hidden = state.kind !== "derivative";
  element("antialias").checked = state.antialias === 1;
  if (document.activeElement !== element("bounces")) element("bounces").value = state.bounces;
  element("undo").disabled = state.undo === 0;
  element("fit").disabled = element("stop").disabled = !state.target;
  if (!element("path").value) element("path").value = state.save;
}

// --- lights over the picture ---------------------------------------------------------------------

function place() {
  const [width, height] = state.size;
  handles.setAttribute("viewBox", `0 0 ${width} ${height}`);
  handles.style.width = `${canvas.clientWidth || width}px`;
  handles.style.height = `${canvas.clientHeight || height}px`;
  if (handles.childElementCount !== state.handles.length) {
    handles.replaceChildren(...state.handles.map((_, k) => {
      const circle = document.createElementNS("http://www.w3.org/2000/svg", "circle");
      circle.setAttribute("r", 7);
      circle.dataset.light = k;
      circle.addEventListener("pointerdown", (event) => grab(event, k));
      return circle;
    }));
  }
  state.handles.forEach((at, k) => {
    const circle = handles.children[k];
    circle.style.display = at ? "" : "none";
    if (!at) return;
    // a light outside of the picture has its handle at the edge
    circle.setAttribute("cx", Math.min(Math.max(at[0], 7), width - 7));
    circle.setAttribute("cy", Math.min(Math.max(at[1], 7), height - 7));
  });
}

function position(event) {
  const box = canvas.getBoundingClientRect();
  return [(event.clientX - box.left) / box.width * state.size[0], (event.clientY - box.top) / box.height * state.size[1]];
}

function grab(event, k) {
  event.stopPropagation();
  event.preventDefault();
  light = k;
  built = "";
  send({ type: "begin" });
  drag(event, (now) => {
    const [x, y] = position(now);
    send({ type: "light", row: k, x, y }, "light");
  });
}

// --- the camera ---------------------------------------------------------------------------------

function drag(event, move, end = () => {}) {
  const target = event.currentTarget;
  target.setPointerCapture(event.pointerId);
  const up = (last) => {
    target.removeEventListener("pointermove", move);
    target.removeEventListener("pointerup", up);
    target.removeEventListener("pointercancel", up);
    end(last);
  };
  target.addEventListener("pointermove", move);
  target.addEventListener("pointerup", up);
  target.addEventListener("pointercancel", up);
}

// Steps of the wheel and the keys add up, also while the answer to the last one is still drawn.
let aim = {}, aiming = 0;

function steer(numbers, key) {
  Object.assign(aim, numbers);
  clearTimeout(aiming);
  aiming = setTimeout(() => { aim = {}; }, 700);
  send({ type: "camera", ...numbers }, key);
}

function turn(theta, phi, from) {
  const limited = Math.min(Math.max(from.phi - phi, 1e-3), Math.PI - 1e-3);
  steer({ theta: from.theta - theta, phi: limited }, "camera");
}

canvas.addEventListener("pointerdown", (event) => {
  if (!state || event.button) return;
  stage.focus();
  const from = { theta: state.values.theta, phi: state.values.phi };
  const [x, y] = [event.clientX, event.clientY];
  let moved = false;
  drag(event, (now) => {
    if (!moved && Math.hypot(now.clientX - x, now.clientY - y) < 4) return;
    if (!moved) send({ type: "begin" });
    moved = true;
    const angle = Math.PI / canvas.clientHeight;
    turn((now.clientX - x) * angle, (now.clientY - y) * angle, from);
  }, (last) => {
    if (moved) return;
    const [column, row] = position(last);
    send({ type: "pick", x: column, y: row });
  });
});

let zooming = 0;

function zoom(factor) {
  if (!zooming) send({ type: "begin" });
  clearTimeout(zooming);
  zooming = setTimeout(() => { zooming = 0; }, 500);
  steer({ mu: Math.max(aim.mu ?? state.values.mu, 1e-3 * state.extent) * factor }, "zoom");
}

stage.addEventListener("wheel", (event) => {
  if (!state) return;
  event.preventDefault();
  const next = Math.exp(Math.sign(event.deltaY) * 0.05);
  // with the shift key the field of view changes: the view plane moves, the eye stays
  if (event.shiftKey) steer({ distance: (aim.distance ?? state.values.distance) / next }, "field");
  else zoom(next);
}, { passive: false });

stage.addEventListener("keydown", (event) => {
  const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  if (!state) return;
  if (event.key in steps) {
    event.preventDefault();
    send({ type: "begin" });
    const [x, y] = steps[event.key];
    turn(x * 0.05, y * 0.05, { ...state.values, ...aim });
  } else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 0.95 : 1 / 0.95);
});

// --- buttons ------------------------------------------------------------------------------------

function choose() {
  const [parameter, column] = element("parameter").value.split(":");
  const owner = Object.entries(state.sliders).find(([, names]) => names.includes(parameter))[0];
  send({ type: "show", kind: element("kind").value, parameter, row: rows[owner](), column: Number(column) });
}

element("kind").addEventListener("change", choose);
element("parameter").addEventListener("change", choose);
element("antialias").addEventListener("change", (event) => send({ type: "options", antialias: event.target.checked ? 1 : 0 }));
element("bounces").addEventListener("change", (event) => send({ type: "options", bounces: Number(event.target.value) }));
element("sphere").addEventListener("change", (event) => send({ type: "sphere", row: Number(event.target.value) }));
element("light").addEventListener("change", (event) => { light = Number(event.target.value); built = ""; build(); refresh(); });
element("fit").addEventListener("click", () => send({ type: "fit" }));
element("stop").addEventListener("click", () => send({ type: "stop" }));
element("undo").addEventListener("click", () => send({ type: "undo" }));
element("save").addEventListener("click", () => send({
  type: "save", path: element("path").value, overwrite: element("overwrite").checked,
}));
element("panel").addEventListener("submit", (event) => event.preventDefault());
window.addEventListener("resize", () => state && place());

connect();
