// What went wrong, or well, in the corner: with cause and hint, as the service tells them.

import { button, fill, h } from "./dom.js";

const corner = () => document.getElementById("messages");
const SHOWN_MS = 8000;

export function say(title, detail = "", { bad = false } = {}) {
  const close = () => { clearTimeout(timer); element.remove(); };
  const element = h(`div.message${bad ? ".bad" : ""}`, { role: bad ? "alert" : "status" },
    h("div", h("b", title), detail && h("p", detail)), button("✕", close, { "aria-label": "close" }));
  const timer = setTimeout(close, bad ? 2 * SHOWN_MS : SHOWN_MS);
  corner().append(element);
  while (corner().children.length > 3) corner().firstChild.remove();
}

export function sayProblem(problem) {
  const more = [problem.detail, ...(problem.errors ?? []).map((one) => one.message ?? JSON.stringify(one)),
    problem.hint && `Try: ${problem.hint}`];
  say(problem.title ?? "That did not work", more.filter(Boolean).join(" "), { bad: true });
}

// Run what a button does, and say what goes wrong; `null` then.
export async function attempt(action) {
  try {
    return await action();
  } catch (error) {
    sayProblem(error.problem ?? { title: "That did not work", detail: error.message });
    return null;
  }
}

// A question in a dialog; resolves to the values of its fields, or null.
export function ask(title, content, { yes = "OK", kind = "primary" } = {}) {
  return new Promise((resolve) => {
    const dialog = h("dialog", { "aria-label": title });
    const form = h("form", { method: "dialog" }, h("h2", title), content,
      h("div.row.even", button("Cancel", () => { dialog.close(); }), h(`button.btn.${kind}`, { type: "submit" }, yes)));
    let answer = null;
    form.addEventListener("submit", () => { answer = true; });
    dialog.addEventListener("close", () => { dialog.remove(); resolve(answer); });
    fill(dialog, form);
    document.body.append(dialog);
    dialog.showModal();
  });
}
