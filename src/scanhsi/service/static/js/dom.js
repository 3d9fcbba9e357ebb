// Elements in one line: h("button.btn.primary", {onclick: go}, "Go").

export function h(what, ...rest) {
  const [tag, ...classes] = what.split(".");
  const element = document.createElement(tag || "div");
  if (classes.length) element.className = classes.join(" ");
  for (const part of rest.flat(3)) {
    if (part === null || part === undefined || part === false) continue;
    if (part instanceof Node || typeof part !== "object") element.append(part);
    else for (const [key, value] of Object.entries(part)) set(element, key, value);
  }
  return element;
}

function set(element, key, value) {
  if (value === null || value === undefined || value === false) return;
  if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
  else if (key === "style") Object.assign(element.style, value);
  else if (key in element && !key.startsWith("aria")) element[key] = value;
  else element.setAttribute(key, value === true ? "" : value);
}

export function fill(element, ...children) {
  element.replaceChildren(...children.flat(3).filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

export function button(text, onclick, { kind = "", title = null, ...more } = {}) {
  return h(`button.btn${kind ? `.${kind}` : ""}`, { type: "button", title, onclick, ...more }, text);
}

// A labelled input with its unit; `value` reads a number where the input is one, and null where it is empty.
export function field(label, { unit = "", type = "number", ...attributes } = {}) {
  const input = h("input", { type, ...(type === "number" ? { step: "any", inputMode: "decimal" } : {}), ...attributes });
  const element = h("label.field", h("span", label), h("span.with-unit", input, unit && h("span.unit", unit)));
  return {
    element,
    input,
    get value() {
      if (type !== "number") return input.value;
      return input.value === "" ? null : Number(input.value);
    },
    set value(to) {
      if (document.activeElement !== input) input.value = to ?? "";
    },
  };
}

export function choice(label, options, attributes = {}) {
  const select = h("select", attributes, options.map(([value, text]) => h("option", { value }, text)));
  return {
    element: h("label.field", h("span", label), select),
    input: select,
    get value() { return select.value; },
    set value(to) { select.value = to; },
  };
}

// One of several, as a row of buttons.
export function segments(options, chosen, onchoose) {
  const buttons = options.map(([value, text]) =>
    button(text, () => { show(value); onchoose(value); }, { "aria-pressed": String(value === chosen) }));
  const show = (value) => buttons.forEach((one, index) => one.setAttribute("aria-pressed", String(options[index][0] === value)));
  return { element: h("div.segments", { role: "group" }, buttons), show };
}

export function stat(label, text = "–") {
  const value = h("b", text);
  const element = h("div.stat", h("span", label), value);
  return {
    element,
    show(to, bad = false) {
      if (value.textContent !== to) value.textContent = to;
      element.classList.toggle("bad", bad);
    },
  };
}

// Redraw when the size changes, in device pixels; `draw(context, width, height, scale)` in CSS pixels.
export function canvas(draw) {
  const element = h("canvas");
  const redraw = () => {
    const scale = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = element;
    if (!width || !height) return;
    const [w, hgt] = [Math.round(width * scale), Math.round(height * scale)];
    if (element.width !== w || element.height !== hgt) [element.width, element.height] = [w, hgt];
    const context = element.getContext("2d");
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, width, height);
    draw(context, width, height);
  };
  let asked = false;
  const later = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; redraw(); });
  };
  new ResizeObserver(later).observe(element);
  return { element, redraw: later };
}
