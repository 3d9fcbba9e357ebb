// References: dark and white, how old they are, whether they still fit; take new ones.

import { get, post } from "../api.js";
import { fill, h } from "../dom.js";
import { ago } from "../format.js";
import { attempt } from "../messages.js";
import { state } from "../store.js";
import { command, commands, controlNote, jobCard } from "./common.js";

const KINDS = [["dark", "Dark", "Cover the lens. Without it, reflectance is wrong where it is dark."],
  ["white", "White", "Put the white tile before the instrument. Without it, there is no reflectance."]];

function open(element, page) {
  const cards = h("div.pane.scrolls", { tabIndex: 0 });
  const load = () => attempt(async () => {
    const results = await get("/results");
    fill(cards, KINDS.map(([kind, name, why]) => card(kind, name, why, results.filter((one) => one.kind === kind))));
    commands(page, cards);
  });
  const job = jobCard(page, ["calibration"], load);
  let camera = "";
  page.on("state", (info) => {
    if (!info || JSON.stringify(info.camera) === camera) return;
    camera = JSON.stringify(info.camera);
    load(); // whether they fit depends on the settings
  });
  element.append(h("div.panes.wide", cards, h("div.pane", controlNote(), job.element,
    h("p.note", "A reference fits as long as gain, pixel format and region are the same. A stale one blocks reflectance, never a raw scan."))));
  commands(page, element);
}

function card(kind, name, why, results) {
  const [last, ...older] = results;
  return h("div.card",
    h("div.row", { style: { justifyContent: "space-between" } }, h("h2", name), command(`Take ${name.toLowerCase()}`, () => post("/calibrations", { kind }), { kind: "primary" })),
    last ? [h("p", h("b", last.id), `, ${ago(last.created)}`), verdict(last), older.length ? h("p.muted", `and ${older.length} older`) : null]
      : h("p.note.warn", `None yet. ${why}`));
}

function verdict(result) {
  if (result.applies) return h("p.note", "Fits the settings of now.");
  return h("p.note.bad", `Does not fit: ${(result.reasons ?? []).join("; ")}`);
}

export default { title: "References", short: "Refs", open };
