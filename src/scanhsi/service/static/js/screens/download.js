// Downloads. Without a token the browser streams it itself; with one the page has to, for a token never stands in an address.

import { BASE, call } from "../api.js";
import { h } from "../dom.js";
import { state } from "../store.js";

export async function download(path) {
  if (!state.token) {
    save(BASE + path, "");
    return;
  }
  const answer = await call("GET", path, undefined, { raw: true });
  const name = /filename="?([^";]+)/.exec(answer.headers.get("Content-Disposition") ?? "")?.[1] ?? "";
  const address = URL.createObjectURL(await answer.blob());
  save(address, name);
  setTimeout(() => URL.revokeObjectURL(address), 60000);
}

function save(href, name) {
  const link = h("a", { href, download: name });
  document.body.append(link);
  link.click();
  link.remove();
}
