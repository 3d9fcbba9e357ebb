// The plan that the next scan uses; kept by the browser, so that a reload forgets nothing.

import { state } from "../store.js";

const FIELDS = ["lines", "step", "start", "mode", "period_s", "look_ahead"];

export function savedPlan() {
  const plan = { ...state.capabilities.default_plan };
  const saved = JSON.parse(localStorage.getItem("scanhsi.plan") ?? "{}");
  if (saved.instrument === state.info.instrument) Object.assign(plan, saved.plan);
  return plan;
}

export function savePlan(plan) {
  localStorage.setItem("scanhsi.plan", JSON.stringify({ instrument: state.info.instrument, plan }));
}

// The body of POST /scans. Exposure, gain and pixel format are the camera's.
export function planOf(plan) {
  const given = Object.fromEntries(FIELDS.filter((name) => plan[name] !== null && plan[name] !== undefined).map((name) => [name, plan[name]]));
  return { plan: given, output: plan.output || null, target: plan.target || null };
}
