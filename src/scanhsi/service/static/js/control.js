// Who is in control: take it, keep it while the page is open, give it up.

import { post, put, remove } from "./api.js";
import { button, field } from "./dom.js";
import { refresh } from "./live.js";
import { ask, attempt } from "./messages.js";
import { on, setLease, state } from "./store.js";

const RENEW_MS = 15000;
const TTL_S = 60;

export const inControl = () => Boolean(state.lease && state.info?.lease);

export function controlButton() {
  const take = button("", toggle, { id: "control" });
  const show = () => {
    const holder = state.info?.lease;
    take.textContent = inControl() ? "Release" : holder ? `${holder.name} controls` : "Take control";
    take.disabled = !inControl() && Boolean(holder);
    take.classList.toggle("primary", !holder);
  };
  on("state", show);
  setInterval(() => inControl() && put("/lease").catch(refresh), RENEW_MS);
  return take;
}

async function toggle() {
  if (inControl()) {
    await attempt(() => remove("/lease"));
    setLease(null);
    await attempt(refresh);
    return;
  }
  const name = field("Your name, for the others", { type: "text", value: localStorage.getItem("scanhsi.name") ?? "", required: true, maxLength: 80 });
  if (!localStorage.getItem("scanhsi.name")) {
    if (!(await ask("Take control", [name.element], { yes: "Take control" }))) return;
    localStorage.setItem("scanhsi.name", name.value);
  }
  await attempt(async () => {
    const lease = await post("/lease", { name: localStorage.getItem("scanhsi.name"), ttl_s: TTL_S });
    setLease(lease.id);
    await refresh(); // what was told meanwhile was told to somebody who looked on
  });
}

// Disable what commands while somebody else is in control, or nobody.
export function whileInControl(element, also = () => true) {
  const controls = () => element.querySelectorAll("[data-command]");
  const show = () => {
    for (const one of controls()) one.disabled = !inControl() || !also();
    const note = element.querySelector("[data-control-note]");
    if (note) note.hidden = inControl();
  };
  const end = on("state", show);
  queueMicrotask(show);
  return end;
}
