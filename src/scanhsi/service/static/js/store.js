// What is known of the service, and who wants to hear of it. One object; screens read it and never write it.

export const state = {
  token: sessionStorage.getItem("scanhsi.token"),
  lease: sessionStorage.getItem("scanhsi.lease"),
  connected: false,
  info: null, // GET /state
  frame: null, // header of the last frame, with its pixels
  rows: null, // header of the last rows of the colour picture
};

const listeners = new Map();

// Hear of a kind of change: "state", "job", "frame", "rows", "log", "theme". Returns what ends it.
export function on(kind, listener) {
  if (!listeners.has(kind)) listeners.set(kind, new Set());
  listeners.get(kind).add(listener);
  return () => listeners.get(kind).delete(listener);
}

export function tell(kind, data) {
  for (const listener of [...(listeners.get(kind) ?? [])]) listener(data);
}

export function setToken(token) {
  state.token = token;
  if (token) sessionStorage.setItem("scanhsi.token", token);
  else sessionStorage.removeItem("scanhsi.token");
}

export function setLease(lease) {
  state.lease = lease;
  if (lease) sessionStorage.setItem("scanhsi.lease", lease);
  else sessionStorage.removeItem("scanhsi.lease");
}
