// System: devices, what is simulated, versions, the log.

import { get, post, put } from "../api.js";
import { choice, fill, h } from "../dom.js";
import { ago } from "../format.js";
import { attempt, say } from "../messages.js";
import { state } from "../store.js";
import { command, commands, controlNote } from "./common.js";

const KEPT = 200;

function open(element, page) {
  const { capabilities: known } = state;
  const log = h("div.fills", { style: { overflowY: "auto" }, tabIndex: 0, role: "log" });
  const add = (event) => {
    log.prepend(h("pre", h(event.level === "error" || event.level === "critical" ? "b" : "span", `${(event.time ?? event.timestamp ?? "").slice(11, 19)} ${event.level}  ${[event.event, event.error ?? event.device].filter(Boolean).join(": ")}`)));
    while (log.children.length > KEPT) log.lastChild.remove();
  };
  page.on("log", add);
  get("/logs").then((events) => events.forEach(add)).catch(() => {});
  const viewers = h("td");
  const holder = h("td");
  page.on("state", (info) => {
    if (!info) return;
    viewers.textContent = String(info.listeners);
    holder.textContent = info.lease?.name ?? "nobody";
  });
  const scenes = known?.scenes?.length ? choice("scene of the simulated camera", known.scenes.map((name) => [name, name]), {
    "data-command": "", onchange: () => attempt(() => put("/scene", { scene: scenes.value })),
  }) : null;
  if (scenes) page.on("state", (info) => info?.scene && (scenes.value = info.scene));
  const rows = known ? [
    ["instrument", known.name], ["description", known.description], ["simulated", known.simulated ? "yes: nothing here is measured" : "no"],
    ...device("camera", known.camera, known.abilities.camera), ...device("actuator", known.actuator, known.abilities.actuator),
    ["data since", state.info ? ago(state.info.started) : "–"],
    ...Object.entries(known.versions),
  ] : [];
  element.append(h("div.panes.wide",
    h("div.pane.scrolls", { tabIndex: 0 }, lostCard(page), h("div.card", h("h2", "Instrument"),
      h("table.names", h("tbody", rows.map(([name, text]) => h("tr", h("th", name), h("td", text))), h("tr", h("th", "in control"), holder), h("tr", h("th", "looking on"), viewers))))),
    h("div.pane", controlNote(), scenes?.element, h("div.card.fills", h("h2", "Log"), log),
      h("p.muted", "Keys: 1 to 9 screens, Escape STOP, L light or dark, arrows jog."),
      h("a.btn", { href: "/api/v1/openapi.json", target: "_blank", rel: "noopener" }, "Description of the interface"))));
  commands(page, element);
}

// What was lost, why, and a button that opens it anew.
function lostCard(page) {
  const again = command("Open anew", async () => {
    again.textContent = "Opening …";
    try {
      await post("/devices/reopen", {});
      say("Open again", "Nothing has moved. The next scan homes the mirror where that is due.");
    } finally {
      again.textContent = "Open anew";
    }
  }, { kind: "primary" });
  const reasons = h("div.list");
  const card = h("div.card", { hidden: true }, h("h2", "Lost"), reasons,
    h("p.muted", "See to power and cable. The next scan or motion opens it anew, or this does, which moves nothing:"), again);
  page.on("state", (info) => {
    const lost = Object.values(info?.lost ?? {});
    card.hidden = !lost.length;
    fill(reasons, lost.map((why) => h("p.note.bad", why)));
  });
  return card;
}

function device(role, info, abilities) {
  return [[role, [info.name, info.model, info.serial].filter(Boolean).join(", ")], [`${role} can`, abilities.join(", ") || "nothing beyond the contract"]];
}

export default { title: "System", open };
