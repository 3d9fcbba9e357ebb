// Plan: what will be scanned, what it will take, whether its pixels are square.

import { get, post, query } from "../api.js";
import { choice, field, fill, h, stat } from "../dom.js";
import { bytes, number, percent, seconds } from "../format.js";
import { attempt } from "../messages.js";
import { state } from "../store.js";
import { button } from "../dom.js";
import { planOf, savedPlan, savePlan } from "./planned.js";

const SOON_MS = 250;

function open(element, page) {
  const plan = savedPlan();
  const lines = field("lines", { min: 1, step: 1, value: plan.lines });
  const step = field("steps a line", { step: 1, value: plan.step });
  const start = field("first step (empty: centred)", { step: 1, value: plan.start ?? "" });
  const height = field("height of the field", { unit: "mm" });
  const mode = choice("mode", state.capabilities.modes.map((name) => [name, name]));
  mode.value = plan.mode;
  const output = field("name of the cube (empty: date and time)", { type: "text", value: plan.output ?? "", placeholder: "hand.zarr" });
  const target = field("what is scanned", { type: "text", value: plan.target ?? "", maxLength: 200 });
  const shown = Object.fromEntries(["field", "pixel", "aspect", "time", "rate", "efficiency", "size", "smear", "edges", "depth"]
    .map((name) => [name, stat({ field: "field", pixel: "pixel", aspect: "pixel aspect", time: "scan time", rate: "lines/s", efficiency: "efficiency", size: "size", smear: "smear", edges: "wider at the ends", depth: "farther at the ends" }[name])]));
  const warning = h("p.note.bad", { hidden: true });
  let asked = null;

  const read = () => ({ ...plan, lines: lines.value, step: step.value, start: start.value, mode: mode.value, output: output.value || null, target: target.value || null });
  const changed = () => {
    savePlan(read());
    clearTimeout(asked);
    asked = setTimeout(tell, SOON_MS);
  };
  const tell = async () => {
    try {
      show(await post("/plan/check", planOf(read()).plan));
      warning.hidden = true;
    } catch (error) {
      warning.hidden = false;
      warning.textContent = [error.problem?.detail ?? error.message, ...(error.problem?.problems ?? [])].join(" ");
    }
  };
  const show = (told) => {
    const fieldOf = told.field;
    shown.time.show(seconds(told.duration_s));
    shown.rate.show(number(told.lines_per_second, 3));
    shown.efficiency.show(percent(told.efficiency));
    shown.size.show(bytes(told.size_bytes), told.size_bytes > state.info.free_bytes);
    shown.smear.show(told.smear_px === null ? "–" : `${number(told.smear_px, 2)} px`, told.smear_px > 0.5);
    if (!fieldOf) return;
    shown.field.show(`${fieldOf.width_mm.toFixed(0)} × ${fieldOf.height_mm.toFixed(0)} mm`);
    shown.pixel.show(`${fieldOf.sample_pitch_mm.toFixed(3)} × ${fieldOf.line_pitch_mm.toFixed(3)} mm`);
    shown.aspect.show(fieldOf.aspect.toFixed(2), Math.abs(fieldOf.aspect - 1) > 0.1);
    shown.edges.show(percent(fieldOf.edge_pitch_mm / fieldOf.line_pitch_mm - 1), !fieldOf.linear);
    shown.depth.show(`${number(fieldOf.defocus_mm)} mm`);
    height.value = fieldOf.height_mm.toFixed(1);
  };
  const square = () => attempt(async () => {
    const found = await get(query("/plan/field", { height_mm: height.value }));
    lines.value = found.lines;
    step.value = found.step;
    start.value = found.start;
    changed();
  });
  for (const one of [lines, step, start, output, target]) one.input.addEventListener("input", changed);
  mode.input.addEventListener("change", changed);
  page.on("state", () => state.info && tell());

  const recipes = choice("recipe", [["", "–"]]);
  const load = () => attempt(async () => {
    const list = await get("/recipes");
    fill(recipes.input, h("option", { value: "" }, list.length ? "choose" : "none yet"), list.map((one) => h("option", { value: one.name }, one.name)));
  });
  element.append(h("div.panes.wide",
    h("div.pane.scrolls",
      h("div.grid2", lines.element, step.element, height.element, h("div", { style: { alignSelf: "end" } }, button("Square pixels", square, { style: { width: "100%" } })), start.element, mode.element, output.element, target.element),
      warning),
    h("div.pane.scrolls",
      h("div.card", h("h2", "What it comes to"), h("div.stats", Object.values(shown).map((one) => one.element))),
      recipes.element,
      button("Scan this", () => { savePlan(read()); location.hash = "#scan"; }, { kind: "primary" }))));
  load();
  tell();
}

export default { title: "Plan", open };
