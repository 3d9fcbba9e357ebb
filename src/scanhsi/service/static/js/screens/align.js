// Align: see what the camera sees, or a quick picture of the whole field; turn the mirror.

import { post } from "../api.js";
import { field, h, segments, stat } from "../dom.js";
import { plot } from "../draw/plot.js";
import { tilt } from "../draw/tilt.js";
import { number } from "../format.js";
import { state } from "../store.js";
import { command, commands, controlNote, framePicture, liveSwitch, rowsPicture } from "./common.js";

const FEW_LINES = 96;
const DEGREES = 180 / Math.PI;

function open(element, page) {
  let lines = Number(localStorage.getItem("scanhsi.lines") ?? 5);
  const overlay = (context, { left, top, width, height }) => {
    context.strokeStyle = "rgb(88 200 255 / .8)";
    context.lineWidth = 1;
    context.beginPath();
    for (let line = 1; line <= lines; line += 1) {
      const y = Math.round(top + (height * line) / (lines + 1)) + 0.5;
      context.moveTo(left, y);
      context.lineTo(left + width, y);
    }
    context.stroke();
    const [x, y, arm] = [left + width / 2, top + height / 2, 18];
    context.strokeStyle = "#ffc233";
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(x - arm, y);
    context.lineTo(x + arm, y);
    context.moveTo(x, y - arm);
    context.lineTo(x, y + arm);
    context.stroke();
  };
  const frame = framePicture(page, { overlay });
  const field_ = rowsPicture(page, { overlay });
  const source = segments([["line", "Line"], ["field", "Field"]], "line", (chosen) => {
    frame.element.hidden = chosen !== "line";
    field_.element.hidden = chosen !== "field";
    (chosen === "line" ? frame : field_).redraw();
  });
  field_.element.hidden = true;

  const step = stat("step");
  const angle = stat("from 45°");
  const tilted = stat("tilt");
  page.on("state", (info) => {
    if (!info) return;
    step.show(info.mirror.step === null ? "unknown" : `${info.mirror.step}${info.mirror.moving ? " …" : ""}`);
    angle.show(info.mirror.angle_rad === null ? "–" : `${number(info.mirror.angle_rad * DEGREES, 4)}°`);
  });
  page.on("rows", (rows) => {
    if (rows.reached < rows.rows) return;
    const found = tilt(field_.pixels(), aspectOf(rows));
    tilted.show(found && found.coherence > 0.2 ? `${found.degrees.toFixed(2)}°` : "–");
  });

  const count = field("overlay lines", { min: 1, max: 31, step: 1, value: lines });
  count.input.addEventListener("input", () => {
    lines = Math.min(31, Math.max(0, Math.round(count.value ?? 0)));
    localStorage.setItem("scanhsi.lines", String(lines));
    frame.redraw();
    field_.redraw();
  });
  const jog = (steps) => command(steps > 0 ? `+${steps}` : `−${-steps}`, () => post("/mirror/jog", { steps }), { "aria-label": `jog ${steps} steps` });
  const profile = plot({ label: "mean along the slit" });
  const spectrum = plot({ label: "mean spectrum" });
  page.on("frame", (shown) => {
    profile.show({ x: places(shown.profile, shown.stride[1]), lines: [{ y: shown.profile }], xlabel: "sample", ylabel: "counts" });
    spectrum.show({ x: places(shown.spectrum, shown.stride[0]), lines: [{ y: shown.spectrum }], xlabel: "band", ylabel: "counts" });
  });
  const controls = h("div.pane.scrolls",
    controlNote(),
    h("div.row.even", liveSwitch(page), command("Field picture", () => { source.show("field"); frame.element.hidden = true; field_.element.hidden = false; return fieldPicture(); })),
    source.element,
    h("div.card", h("div.stats", step.element, angle.element, tilted.element)),
    h("div.row.even", jog(-100), jog(-10), jog(-1)),
    h("div.row.even", jog(100), jog(10), jog(1)),
    h("div.row.even", command("Home", () => post("/mirror/home")), command("Go to 45°", () => post("/mirror/goto", { step: state.capabilities.config.geometry.normal_step }))),
    count.element);
  element.append(h("div.panes", h("div.pane", frame.element, field_.element),
    h("div.pane.plots", h("div.card.fills", h("h2", "Along the slit"), profile.element), h("div.card.fills", h("h2", "Spectrum"), spectrum.element)),
    controls));
  page.on("key", (event) => {
    const steps = { ArrowUp: 1, ArrowDown: -1, PageUp: 10, PageDown: -10 }[event.key];
    if (steps && state.lease) post("/mirror/jog", { steps }).catch(() => {});
  });
  commands(page, controls);
}

const places = (values, stride) => values.map((_, index) => index * stride);

// A few lines over the whole field of the default plan, not stored.
function fieldPicture() {
  const { lines, step, exposure_s: exposure } = state.capabilities.default_plan;
  const every = Math.max(1, Math.round((lines * (step ?? 1)) / FEW_LINES));
  return post("/scans", { discard: true, target: "field picture", plan: { lines: FEW_LINES, step: every, mode: "stepped", exposure_s: Math.min(exposure, state.info.camera.exposure_s) } });
}

// Height of a row of the field picture over the width of a column, on the target.
function aspectOf(rows) {
  const geometry = state.capabilities.config.geometry;
  if (!geometry.sample_pitch_m) return 1;
  const { lines, step } = state.capabilities.default_plan;
  const every = Math.max(1, Math.round((lines * (step ?? 1)) / FEW_LINES));
  const down = ((4 * Math.PI) / geometry.steps_per_revolution) * every * rows.lines_per_row * geometry.distance_m;
  return down / (geometry.sample_pitch_m * (state.capabilities.shape[1] / rows.width));
}

export default { title: "Align", open };
