// The REST interface. Errors are problem details; commands carry the lease, and a key that makes a repeated one harmless.

import { setLease, setToken, state, tell } from "./store.js";

export const BASE = "/api/v1";

export class Failed extends Error {
  constructor(problem) {
    super(problem.detail ?? problem.title);
    this.problem = problem;
  }
}

export async function call(method, path, body = undefined, { raw = false } = {}) {
  const headers = { Accept: "application/json" };
  if (body !== undefined) headers["Content-Type"] = "application/json";
  if (state.token) headers.Authorization = `Bearer ${state.token}`;
  if (state.lease && method !== "GET") headers["Scanhsi-Lease"] = state.lease;
  if (method === "POST") headers["Idempotency-Key"] = key();
  let answer;
  try {
    answer = await fetch(BASE + path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
  } catch {
    throw new Failed({ title: "The service does not answer", detail: "It has ended, or the network is down." });
  }
  if (answer.ok) return raw ? answer : answer.status === 204 ? null : answer.json();
  const problem = await answer.json().catch(() => ({ title: `${answer.status} ${answer.statusText}`, detail: "" }));
  if (problem.error === "NotInControl") setLease(null);
  if (answer.status === 401) {
    setToken(null);
    tell("unauthorised");
  }
  throw new Failed(problem);
}

// Also where the page is not served over TLS, which is where browsers have no crypto.randomUUID.
function key() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

export const get = (path) => call("GET", path);
export const post = (path, body = {}) => call("POST", path, body);
export const put = (path, body = {}) => call("PUT", path, body);
export const patch = (path, body) => call("PATCH", path, body);
export const remove = (path, body) => call("DELETE", path, body);

export function query(path, parameters) {
  const given = Object.entries(parameters).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return given.length ? `${path}?${new URLSearchParams(given)}` : path;
}

// A picture of the service, as something that can be drawn, with what its headers tell.
export async function image(path) {
  const answer = await call("GET", path, undefined, { raw: true });
  return { bitmap: await createImageBitmap(await answer.blob()), headers: answer.headers };
}
