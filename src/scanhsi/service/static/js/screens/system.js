// System: devices, what is simulated, versions, the log.

import { get, put } from "../api.js";
import { choice, h } from "../dom.js";
import { ago } from "../format.js";
import { attempt } from "../messages.js";
import { state } from "../store.js";
import { commands, controlNote } from "./common.js";

const KEPT = 200;

function open(element, page) {
  const { capabilities: known } = state;
  const log = h("div.fills", { style: { overflowY: "auto" }, tabIndex: 0, role: "log" });
  const add = (event) => {
    log.prepend(h("pre", h(event.level === "error" || event.level === "critical" ? "b" : "span", `${(event.time ?? event.timestamp ?? "").slice(11, 19)} ${event.level}  ${event.event}`)));
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
    h("div.pane.scrolls", { tabIndex: 0 }, h("div.card", h("h2", "Instrument"),
      h("table.names", h("tbody", rows.map(([name, text]) => h("tr", h("th", name), h("td", text))), h("tr", h("th", "in control"), holder), h("tr", h("th", "looking on"), viewers))))),
    h("div.pane", controlNote(), scenes?.element, h("div.card.fills", h("h2", "Log"), log),
      h("p.muted", "Keys: 1 to 9 screens, Escape STOP, L light or dark, arrows jog."),
      h("a.btn", { href: "/api/v1/openapi.json", target: "_blank", rel: "noopener" }, "Description of the interface"))));
  commands(page, element);
}

function device(role, info, abilities) {
  return [[role, [info.name, info.model, info.serial].filter(Boolean).join(", ")], [`${role} can`, abilities.join(", ") || "nothing beyond the contract"]];
}

export default { title: "System", open };
