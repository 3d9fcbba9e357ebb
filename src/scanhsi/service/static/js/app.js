// The frame of all screens: bar, rail, STOP, keys, themes.

import { get, post } from "./api.js";
import { controlButton } from "./control.js";
import { button, field, fill, h } from "./dom.js";
import { forget } from "./draw/colours.js";
import { bytes, percent, seconds } from "./format.js";
import { listen, refresh } from "./live.js";
import { ask, attempt, say, sayProblem } from "./messages.js";
import align from "./screens/align.js";
import calibrate from "./screens/calibrate.js";
import expose from "./screens/expose.js";
import focus from "./screens/focus.js";
import plan from "./screens/plan.js";
import references from "./screens/references.js";
import scan from "./screens/scan.js";
import system from "./screens/system.js";
import view from "./screens/view.js";
import { on, setToken, state, tell } from "./store.js";

const SCREENS = { align, focus, expose, references, plan, scan, view, calibrate, system };

let leave = null;

async function show() {
  const name = location.hash.slice(1).split("/")[0] || "align";
  const screen = SCREENS[name] ?? align;
  if (leave) leave();
  const ended = [];
  const element = h("div", { style: { height: "100%" } });
  fill(document.getElementById("screen"), element);
  document.title = `${screen.title} – scanhsi`;
  for (const link of document.querySelectorAll("#rail a")) {
    if (link.hash === `#${name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  leave = () => ended.forEach((end) => end());
  // What a screen listens to ends with it.
  screen.open(element, { on: (kind, listener) => ended.push(on(kind, listener)), ended: (end) => ended.push(end) });
  tell("state", state.info);
  if (state.frame) tell("frame", state.frame);
}

function bar() {
  const name = h("b", "scanhsi");
  const doing = h("small", "connecting");
  const badge = h("div.badge", { hidden: true, title: "A device is simulated: nothing here was measured" }, "SIMULATED");
  const facts = h("div.facts");
  const stop = button("STOP", stopAll, { id: "stop", title: "Stop the mirror, end what is under way (Escape)" });
  const theme = button("◐", toggleTheme, { title: "Light or dark (L)", "aria-label": "light or dark" });
  fill(document.getElementById("bar"), h("div.name", name, doing), badge, facts, theme, controlButton(), stop);
  let progress = null;
  const draw = () => {
    const info = state.info;
    if (!info) return;
    name.textContent = info.instrument;
    badge.hidden = !info.simulated;
    const lost = Object.keys(info.lost);
    doing.textContent = !state.connected ? "service does not answer" : lost.length ? `${lost.join(", ")} lost` : info.busy;
    doing.classList.toggle("bad", !state.connected || lost.length > 0);
    const fact = (label, text) => h("div.fact", h("span", label), text);
    fill(facts,
      fact("exposure", seconds(info.camera.exposure_s)),
      fact("gain", `${info.camera.gain_db} dB`),
      progress && info.job && fact("lines/s", progress.lines_per_second?.toFixed(1) ?? "–"),
      progress && info.job && fact("efficiency", percent(progress.efficiency)),
      fact("mirror", info.mirror.step === null ? "unknown" : `step ${info.mirror.step}`),
      fact("free disk", bytes(info.free_bytes)));
  };
  on("state", draw);
  on("progress", (data) => { progress = data; draw(); });
}

async function stopAll() {
  if (await attempt(() => post("/stop"))) say("Stopped", "The mirror stands still; what was under way has ended.");
}

function toggleTheme() {
  const root = document.documentElement;
  root.dataset.theme = root.dataset.theme === "light" ? "dark" : "light";
  localStorage.setItem("scanhsi.theme", root.dataset.theme);
  forget();
  tell("theme");
  show();
}

function rail() {
  const links = Object.entries(SCREENS).map(([name, screen], index) =>
    h("a", { href: `#${name}` }, h("span", screen.short ?? screen.title), h("kbd", String(index + 1))));
  fill(document.getElementById("rail"), links);
}

function keys(event) {
  if (event.target.matches("input, select, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape") stopAll();
  else if (/^[1-9]$/.test(event.key)) location.hash = Object.keys(SCREENS)[Number(event.key) - 1];
  else if (event.key.toLowerCase() === "l") toggleTheme();
  else tell("key", event);
}

async function askToken() {
  const token = field("Token of the service", { type: "password", required: true, autocomplete: "off" });
  if (!(await ask("This service wants a token", [token.element], { yes: "Sign in" }))) return;
  setToken(token.value);
  location.reload();
}

async function begin() {
  document.documentElement.dataset.theme =
    localStorage.getItem("scanhsi.theme") ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
  bar();
  rail();
  addEventListener("hashchange", show);
  addEventListener("keydown", keys);
  on("unauthorised", askToken);
  on("job", (job) => {
    if (job.state === "failed" && job.problem) sayProblem({ ...job.problem, title: `${job.title}: failed` });
    if (job.state === "done" && job.kind !== "scan") say(job.title, "Done.");
  });
  try {
    await refresh();
    state.capabilities = await get("/capabilities");
  } catch (error) {
    if (!state.token && error.problem?.status === 401) return;
    sayProblem(error.problem ?? { title: "Cannot begin", detail: error.message });
  }
  listen();
  show();
}

begin();
