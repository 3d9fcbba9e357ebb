// Plan: what will be scanned, what it will take, whether its pixels are square.

import { get, post, put } from "../api.js";
import { button, choice, field, fill, h, stat } from "../dom.js";
import { bytes, number, percent, seconds } from "../format.js";
import { ask, attempt, say } from "../messages.js";
import { state } from "../store.js";
import { command, commands } from "./common.js";
import { planOf, savedPlan, savePlan } from "./planned.js";

const SOON_MS = 250;

function open(element, page) {
  const plan = savedPlan();
  const lines = field("lines", { min: 1, step: 1 });
  const step = field("steps a line", { step: 1 });
  const start = field("first step", { step: 1, placeholder: "centred" });
  const height = field("height of the field", { unit: "mm", min: 0 });
  const mode = choice("mode", state.capabilities.modes.map((name) => [name, name]));
  const output = field("name of the cube", { type: "text", placeholder: "date and time" });
  const target = field("what is scanned", { type: "text", maxLength: 200 });
  const fields = { lines, step, start, mode, output, target };
  const set = (to) => Object.entries(fields).forEach(([name, one]) => { one.value = to[name] ?? ""; });
  const read = () => ({ ...plan, ...Object.fromEntries(Object.entries(fields).map(([name, one]) => [name, one.value === "" ? null : one.value])) });
  const facts = factsCard();
  const warning = h("p.note.bad", { hidden: true });

  const tell = async () => {
    try {
      const told = await post("/plan", planOf(read()).plan);
      facts.show(told);
      if (told.field.height_mm !== null) height.value = told.field.height_mm.toFixed(1);
      warning.hidden = true;
    } catch (error) {
      warning.hidden = false;
      warning.textContent = [error.problem?.detail ?? error.message, ...(error.problem?.problems ?? [])].join(" ");
    }
  };
  let asked = null;
  const changed = () => {
    savePlan(read());
    clearTimeout(asked);
    asked = setTimeout(tell, SOON_MS);
  };
  page.ended(() => clearTimeout(asked));
  const square = () => attempt(async () => {
    const { lines: count, step: every, start: first } = await post("/plan/field", { height_mm: height.value });
    set({ ...read(), lines: count, step: every, start: first });
    changed();
  });
  for (const one of Object.values(fields)) one.input.addEventListener("input", changed);
  page.on("state", tellOnce(tell));

  const recipes = choice("recipe", [["", "–"]], {
    onchange: () => attempt(async () => {
      if (!recipes.value) return;
      const recipe = await get(`/recipes/${recipes.value}`);
      set({ ...read(), ...recipe.plan, target: recipe.target });
      changed();
    }),
  });
  const load = async () => {
    const list = await get("/recipes");
    fill(recipes.input, h("option", { value: "" }, list.length ? "choose" : "none yet"), list.map((one) => h("option", { value: one.name }, one.name)));
  };
  const keep = async () => {
    const name = field("name", { type: "text", required: true, pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]*" });
    if (!(await ask("Keep this plan as a recipe", [name.element], { yes: "Keep" }))) return;
    const { plan: given, target: what } = planOf(read());
    await put(`/recipes/${name.value}`, { plan: given, target: what });
    say("Kept", `Recipe ${name.value}.`);
    await load();
  };
  const inputs = h("div.pane.scrolls",
    h("div.grid2",
      h("div.row.even", lines.element, step.element), h("div.row.even", start.element, mode.element),
      height.element, button("Square pixels", square, { title: "Lines and steps for this height, with square pixels", style: { alignSelf: "end" } }),
      output.element, target.element,
      recipes.element, command("Keep as recipe", keep, { style: { alignSelf: "end" } })),
    warning);
  element.append(h("div.panes.wide", inputs,
    h("div.pane.scrolls", facts.element,
      button("To the scan", () => { savePlan(read()); location.hash = "#scan"; }, { kind: "primary" }))));
  commands(page, inputs);
  set(plan);
  attempt(load);
  tell();
}

// The camera's settings change what a plan comes to; the rest of the state does not.
function tellOnce(tell) {
  let camera = JSON.stringify(state.info?.camera);
  return (info) => {
    if (!info || JSON.stringify(info.camera) === camera) return;
    camera = JSON.stringify(info.camera);
    tell();
  };
}

function factsCard() {
  const shown = Object.fromEntries(Object.entries({
    time: "scan time", rate: "lines/s", efficiency: "efficiency", size: "size", exposure: "exposure", aspect: "pixel aspect",
    field: "field, mm", pixel: "pixel, mm", smear: "smear, lines", stretch: "wider at ends", depth: "farther at ends",
  }).map(([name, label]) => [name, stat(label)]));
  const show = ({ size_bytes: size, time, field: seen, plan }) => {
    shown.exposure.show(seconds(plan.exposure_s));
    shown.time.show(time ? seconds(time.scan_s) : "–");
    shown.rate.show(time ? number(time.lines_per_second) : "–");
    shown.efficiency.show(time ? percent(time.efficiency) : "–");
    shown.smear.show(time ? number(time.smear, 2) : "–", time?.smear > 1);
    shown.size.show(bytes(size), size > state.info.free_bytes);
    shown.field.show(`${number(seen.width_mm)} × ${number(seen.height_mm)}`);
    shown.pixel.show(`${number(seen.sample_pitch_mm)} × ${number(seen.line_pitch_mm)}`);
    shown.aspect.show(seen.aspect === null ? "–" : seen.aspect.toFixed(2), Math.abs(seen.aspect - 1) > 0.25);
    shown.stretch.show(seen.edge_stretch === null ? "∞" : percent(seen.edge_stretch - 1), !seen.linear);
    shown.depth.show(seen.defocus_mm === null ? "∞" : `${number(seen.defocus_mm, 2)} mm`);
  };
  return { element: h("div.card", h("h2", "What it comes to"), h("div.stats.two", Object.values(shown).map((one) => one.element))), show };
}

export default { title: "Plan", open };
