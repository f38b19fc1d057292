// SPDX-License-Identifier: Apache-2.0
// The live view: asks the server for the picture of a scene, its truth and what is around, and draws them. One request of
// each kind at a time: a slider that moves on asks again when the last answer is there.
"use strict";
const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.hash.slice(1)).get("token");
const DEGREE = Math.PI / 180;
// Names of bright stars (IAU) by their Hipparcos numbers.
const NAMES = {
  677: "Alpheratz", 746: "Caph", 3179: "Schedar", 3419: "Diphda", 5447: "Mirach", 7588: "Achernar", 9640: "Almach", 9884: "Hamal",
  11767: "Polaris", 14135: "Menkar", 14576: "Algol", 15863: "Mirfak", 17702: "Alcyone", 21421: "Aldebaran", 24436: "Rigel",
  24608: "Capella", 25336: "Bellatrix", 25428: "Elnath", 25930: "Mintaka", 26311: "Alnilam", 26727: "Alnitak", 27366: "Saiph",
  27989: "Betelgeuse", 28360: "Menkalinan", 30438: "Canopus", 31681: "Alhena", 32349: "Sirius", 33579: "Adhara", 34444: "Wezen",
  36850: "Castor", 37279: "Procyon", 37826: "Pollux", 45238: "Miaplacidus", 46390: "Alphard", 49669: "Regulus", 53910: "Merak",
  54061: "Dubhe", 57632: "Denebola", 60718: "Acrux", 61084: "Gacrux", 62434: "Mimosa", 62956: "Alioth", 63608: "Vindemiatrix",
  65378: "Mizar", 65474: "Spica", 67301: "Alkaid", 68702: "Hadar", 69673: "Arcturus", 71683: "Rigil Kentaurus", 72607: "Kochab",
  76267: "Alphecca", 80763: "Antares", 85927: "Shaula", 86032: "Rasalhague", 87833: "Eltanin", 90185: "Kaus Australis", 91262: "Vega",
  92855: "Nunki", 95947: "Albireo", 97649: "Altair", 100453: "Sadr", 100751: "Peacock", 102098: "Deneb", 105199: "Alderamin",
  30324: "Mirzam", 41037: "Avior", 42913: "Alsephina", 50583: "Algieba", 68933: "Menkent", 71681: "Toliman", 82273: "Atria", 86228: "Sargas",
  107315: "Enif", 109268: "Alnair", 113368: "Fomalhaut", 113881: "Scheat", 113963: "Markab",
};
const star_name = (id) => NAMES[id] || (id < 1e9 ? "HIP " + id : "star " + id);
const state = { cameras: [], truth: null, sky: null, drawn: 0, followed: null, errors: 0 };

async function get(path, scene) {
  const query = scene ? "?scene=" + encodeURIComponent(JSON.stringify(scene)) : "";
  const answer = await fetch(path + query, { headers: token ? { Authorization: "Bearer " + token } : {} });
  if (answer.ok) return answer;
  const said = await answer.json().catch(() => ({ message: "the server answered " + answer.status }));
  throw new Error(said.message);
}

function say(text, bad) {
  $("status").textContent = text;
  $("status").className = bad ? "bad" : "";
}

// --- the scene

const number = (id) => Number($(id).value);
const exposure_ms = () => Math.pow(10, number("exposure"));

function scene() {
  return {
    epoch: $("epoch").value, observer: $("observer").value, camera: $("camera").value,
    attitude: { ra_deg: number("ra"), dec_deg: number("dec"), roll_deg: number("roll") },
    exposure_ms: exposure_ms(), effects: $("noise").checked ? "all" : "expected",
  };
}

function show_values() {
  $("ra_out").textContent = number("ra").toFixed(2) + "\u00b0";
  $("dec_out").textContent = number("dec").toFixed(2) + "\u00b0";
  $("roll_out").textContent = number("roll").toFixed(1) + "\u00b0";
  const ms = exposure_ms();
  $("exposure_out").textContent = ms < 1000 ? ms.toPrecision(3) + " ms" : (ms / 1000).toPrecision(3) + " s";
}

let busy = false, again = false;
async function update() {
  show_values();
  if (busy) { again = true; return; }
  busy = true;
  do {
    again = false;
    const wanted = state.followed || scene();
    const begin = performance.now();
    try {
      const [blob, truth, sky] = await Promise.all([
        get("/api/view.png", wanted).then((a) => a.blob()), get("/api/truth", wanted).then((a) => a.json()),
        get("/api/sky", wanted).then((a) => a.json())]);
      const bitmap = await createImageBitmap(blob);
      state.truth = truth;
      state.sky = sky;
      state.bitmap = bitmap;
      draw_image();
      draw_sky();
      draw_craft();
      state.drawn += 1;
      document.documentElement.dataset.drawn = state.drawn;
      say((performance.now() - begin).toFixed(0) + " ms");
      const count = truth.sources.length;
      $("told").textContent = truth.camera + ", " + truth.epoch_tdb + " TDB, RA " + truth.ra_deg.toFixed(3) + "\u00b0, Dec " +
        truth.dec_deg.toFixed(3) + "\u00b0, roll " + ((truth.roll_deg + 180.005) % 360 - 180.005).toFixed(2).replace("-0.00", "0.00") + "\u00b0, " + truth.exposure_ms.toPrecision(3) +
        " ms, " + count + (count === 1 ? " source" : " sources") + ". Point at one for its name.";
    } catch (error) {
      say(error.message, true);
    }
  } while (again);
  busy = false;
}

// --- the picture

function title(source) {
  const mag = "V " + source.mag.toFixed(2);
  if (source.name) return source.name + ", " + mag;
  return star_name(source.id) + (NAMES[source.id] ? " (HIP " + source.id + "), " : ", ") + mag;
}

function draw_image() {
  const canvas = $("image"), bitmap = state.bitmap;
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
    canvas.width = bitmap.width;
    canvas.height = bitmap.height;
  }
  const g = canvas.getContext("2d");
  g.drawImage(bitmap, 0, 0);
  const size = Math.max(1, canvas.width / 700);
  g.font = 12 * size + "px system-ui, sans-serif";
  g.lineWidth = size;
  for (const s of state.truth.sources) {
    const body = Boolean(s.name);
    if (!body && !($("names").checked && s.mag < 4)) continue;
    g.strokeStyle = g.fillStyle = body ? "#ffcf6b" : "#6cb6ff";
    g.beginPath();
    g.arc(s.u_px + 0.5, s.v_px + 0.5, 9 * size, 0, 7);
    g.stroke();
    g.fillText(body ? s.name : star_name(s.id), s.u_px + 12 * size, s.v_px + 4 * size);
  }
}

function point_at(event) {
  const canvas = $("image"), box = canvas.getBoundingClientRect(), label = $("label");
  const scale = canvas.width / box.width;
  const u = (event.clientX - box.left) * scale - 0.5, v = (event.clientY - box.top) * scale - 0.5;
  let best = null, least = 14 * scale;
  for (const s of state.truth ? state.truth.sources : []) {
    const d = Math.hypot(s.u_px - u, s.v_px - v);
    // A bright star is meant rather than a faint one a little nearer.
    if (d < 14 * scale && d + 2 * scale * s.mag < least + 20 * scale) { best = s; least = d + 2 * scale * s.mag - 20 * scale; }
  }
  label.hidden = !best;
  if (!best) return;
  label.textContent = title(best);
  label.style.left = Math.min((best.u_px + 0.5) / scale + 14, box.width - label.offsetWidth - 4) + "px";
  label.style.top = Math.max((best.v_px + 0.5) / scale - 30, 4) + "px";
}

// --- vectors and rotations; q_NC takes the camera's components to ICRF

const from_radec = (ra, dec) => [Math.cos(dec * DEGREE) * Math.cos(ra * DEGREE), Math.cos(dec * DEGREE) * Math.sin(ra * DEGREE), Math.sin(dec * DEGREE)];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, s) => a.map((x) => x * s);
const sum = (a, b) => a.map((x, i) => x + b[i]);
const unit = (a) => scaled(a, 1 / Math.hypot(...a));
function rotate(q, p) {
  const v = [q.x, q.y, q.z], t = scaled(cross(v, p), 2);
  return sum(sum(p, scaled(t, q.w)), cross(v, t));
}

// --- the sky around: Hammer's equal-area projection, RA to the left

function hammer(ra, dec, canvas) {
  const l = -((((ra + 180) % 360) + 360) % 360 - 180) * DEGREE, b = dec * DEGREE;
  const k = 1 / Math.sqrt(1 + Math.cos(b) * Math.cos(l / 2));
  return [canvas.width / 2 * (1 + k * Math.cos(b) * Math.sin(l / 2)), canvas.height / 2 * (1 - k * Math.sin(b))];
}

function line(g, canvas, points, closed) {
  g.beginPath();
  let before = null;
  for (const p of closed ? [...points, points[0]] : points) {
    if (!p) continue;
    const at = hammer(p[0], p[1], canvas);
    // Over the chart's edge the line is taken up on the other side.
    if (before && Math.abs(at[0] - before[0]) < canvas.width / 3) g.lineTo(at[0], at[1]);
    else g.moveTo(at[0], at[1]);
    before = at;
  }
  g.stroke();
}

function draw_sky() {
  const canvas = $("sky"), g = canvas.getContext("2d"), sky = state.sky;
  g.clearRect(0, 0, canvas.width, canvas.height);
  g.strokeStyle = "#242d42";
  g.lineWidth = 1;
  for (let ra = -180; ra <= 180; ra += 30) line(g, canvas, Array.from({ length: 37 }, (_, i) => [ra === -180 ? 180 : ra === 180 ? 180.001 : ra, i * 5 - 90]));
  for (let dec = -60; dec <= 60; dec += 30) line(g, canvas, Array.from({ length: 73 }, (_, i) => [i * 5 - 179.99, dec]));
  for (const [ra, dec, mag] of sky.stars) {
    const [x, y] = hammer(ra, dec, canvas);
    g.fillStyle = "#dde3ee";
    g.beginPath();
    g.arc(x, y, Math.max(0.5, 2.2 - 0.4 * mag), 0, 7);
    g.fill();
  }
  g.font = "12px system-ui, sans-serif";
  const mark = (at, colour, text, radius) => {
    const [x, y] = hammer(at.ra_deg, at.dec_deg, canvas);
    g.fillStyle = colour;
    g.beginPath();
    g.arc(x, y, radius, 0, 7);
    g.fill();
    g.fillText(text, x + radius + 3, y + 4);
  };
  for (const b of sky.bodies) mark(b, "#ffcf6b", b.name.replace(" barycenter", ""), 2.5);
  if (sky.sun) mark(sky.sun, "#fff06a", "Sun", 5);
  g.strokeStyle = "#6cb6ff";
  g.lineWidth = 2;
  if (sky.field.length > 2) line(g, canvas, sky.field, true);
  const [x, y] = hammer(sky.ra_deg, sky.dec_deg, canvas);
  g.beginPath();
  g.moveTo(x - 4, y); g.lineTo(x + 4, y); g.moveTo(x, y - 4); g.lineTo(x, y + 4);
  g.stroke();
}

// --- the spacecraft: a box with two panels and the camera's baffle, seen from ICRF +x with +z up

function faces() {
  const out = [];
  const box = (cx, cy, cz, sx, sy, sz, colour) => {
    const at = (i, j, k) => [cx + i * sx, cy + j * sy, cz + k * sz];
    for (const s of [-1, 1]) {
      out.push({ points: [at(s, -1, -1), at(s, 1, -1), at(s, 1, 1), at(s, -1, 1)], normal: [s, 0, 0], colour });
      out.push({ points: [at(-1, s, -1), at(1, s, -1), at(1, s, 1), at(-1, s, 1)], normal: [0, s, 0], colour });
      out.push({ points: [at(-1, -1, s), at(1, -1, s), at(1, 1, s), at(-1, 1, s)], normal: [0, 0, s], colour });
    }
  };
  box(0, 0, 0, 0.5, 0.5, 0.8, [200, 190, 160]);
  box(-1.75, 0, 0, 1.1, 0.03, 0.6, [70, 100, 200]);
  box(1.75, 0, 0, 1.1, 0.03, 0.6, [70, 100, 200]);
  box(0, 0, 1.05, 0.28, 0.28, 0.25, [120, 125, 135]);
  return out;
}

function draw_craft() {
  const canvas = $("craft"), g = canvas.getContext("2d"), sky = state.sky;
  g.clearRect(0, 0, canvas.width, canvas.height);
  const towards = unit([1, 0.35, 0.3]), right = unit(cross([0, 0, 1], towards)), up = cross(towards, right);
  const size = canvas.height / 5.2;
  const put = (p) => {
    const depth = 12 / (12 - dot(p, towards));
    return [canvas.width / 2 + size * depth * dot(p, right), canvas.height / 2 - size * depth * dot(p, up)];
  };
  const sun = sky.sun ? from_radec(sky.sun.ra_deg, sky.sun.dec_deg) : [0, 0, 1];
  const arrow = (to, colour, text) => {
    const [x, y] = put(to), [x0, y0] = put(scaled(to, 0.3));
    g.strokeStyle = g.fillStyle = colour;
    g.lineWidth = 2;
    g.beginPath(); g.moveTo(x0, y0); g.lineTo(x, y); g.stroke();
    g.beginPath(); g.arc(x, y, 3.5, 0, 7); g.fill();
    g.font = "13px system-ui, sans-serif";
    g.fillText(text, x + 7, y + 4);
  };
  const boresight = rotate(sky.q_NC, [0, 0, 1]);
  const arrows = [[scaled(sun, 2.9), "#fff06a", "Sun"], [scaled(boresight, 2.9), "#ffffff", "boresight"]];
  for (const [axis, name] of [[[1.9, 0, 0], "x"], [[0, 1.9, 0], "y"], [[0, 0, 1.9], "z"]]) arrows.push([axis, "#46536f", name]);
  for (const a of arrows) if (dot(a[0], towards) < 0) arrow(...a);
  const drawn = faces().map((f) => {
    const points = f.points.map((p) => rotate(sky.q_NC, p));
    const middle = scaled(points.reduce(sum), 0.25);
    return { points, depth: dot(middle, towards), normal: rotate(sky.q_NC, f.normal), colour: f.colour, middle };
  }).filter((f) => dot(f.normal, sum(scaled(towards, 12), scaled(f.middle, -1))) > 0).sort((a, b) => a.depth - b.depth);
  for (const f of drawn) {
    const light = 0.18 + 0.82 * Math.max(0, dot(f.normal, sun));
    g.fillStyle = g.strokeStyle = "rgb(" + f.colour.map((c) => Math.round(c * light)).join(",") + ")";
    g.lineWidth = 1;
    g.beginPath();
    f.points.forEach((p, i) => { const [x, y] = put(p); if (i) g.lineTo(x, y); else g.moveTo(x, y); });
    g.closePath();
    g.fill();
    g.stroke();
  }
  for (const a of arrows) if (dot(a[0], towards) >= 0) arrow(...a);
}

// --- to begin with, and while it runs

async function save() {
  try {
    const answer = await get("/api/frame.png", state.followed || scene());
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await answer.blob());
    link.download = "frame.png";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    say("saved: 16 bits, the values are DN");
    document.documentElement.dataset.saved = "yes";
  } catch (error) {
    say(error.message, true);
  }
}

let seen = -1;
async function follow() {
  if ($("follow").checked) {
    try {
      const latest = await (await get("/api/latest")).json();
      if (latest.scene && latest.frames !== seen) {
        seen = latest.frames;
        state.followed = latest.scene;
        delete state.followed.format;
        delete state.followed.truth;
        await update();
      } else if (!latest.scene) {
        say("no client has asked for a picture yet");
      }
    } catch (error) {
      say(error.message, true);
    }
  }
  setTimeout(follow, 300);
}

async function start() {
  window.addEventListener("error", () => { document.documentElement.dataset.errors = ++state.errors; });
  document.documentElement.dataset.errors = 0;
  try {
    const info = await (await get("/api/info")).json();
    for (const camera of info.cameras) $("camera").add(new Option(camera.name + ", " + camera.fov_h_deg.toFixed(0) + "\u00b0", camera.name));
    if (info.settings.camera) $("camera").value = info.settings.camera;
    if (info.settings.exposure_ms) $("exposure").value = Math.log10(info.settings.exposure_ms);
    for (const name of [...info.observers, "earth", "mars", "jupiter", "moon"]) $("observers").append(new Option(name));
  } catch (error) {
    return say(error.message, true);
  }
  for (const id of ["ra", "dec", "roll", "exposure", "camera", "observer", "epoch", "noise"]) {
    $(id).addEventListener(id === "observer" || id === "epoch" ? "change" : "input", () => {
      $("follow").checked = false;
      state.followed = null;
      update();
    });
  }
  $("controls").addEventListener("submit", (event) => event.preventDefault());
  $("names").addEventListener("input", () => { if (state.bitmap) draw_image(); });
  $("follow").addEventListener("input", () => { seen = -1; if (!$("follow").checked) { state.followed = null; update(); } });
  $("image").addEventListener("mousemove", point_at);
  $("image").addEventListener("mouseleave", () => { $("label").hidden = true; });
  $("save").addEventListener("click", save);
  await update();
  follow();
}
start();
