/*
 * Elements of a page, made without markup.
 *
 * Names of vehicles, sentences of events and lines of files may have been written by anybody. They
 * get into a page through `textContent` only, never as HTML: what looks like markup is shown as
 * written. Every file of this folder adds its part to the one global object `Covey`.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  /*
   * Returns a new element.
   *
   * `properties` are `className`, `title`, `href`, `dataset`, `on` (name of an event -> function) and
   * plain attributes by their names. Children are elements or texts; null is left out.
   */
  function element(tag, properties = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(properties)) {
      if (value === null || value === undefined || value === false) continue;

      if (name === "className") made.className = value;
      else if (name === "dataset") Object.assign(made.dataset, value);
      else if (name === "on") addListeners(made, value);
      else made.setAttribute(name, value === true ? "" : String(value));
    }

    append(made, children);
    return made;
  }

  function addListeners(target, functions) {
    for (const [event, listener] of Object.entries(functions)) {
      target.addEventListener(event, listener);
    }
  }

  function append(parent, children) {
    for (const child of children.flat(Infinity)) {
      if (child === null || child === undefined || child === false) continue;
      parent.append(child instanceof Node ? child : document.createTextNode(String(child)));
    }
  }

  /* Puts other children into an element. */
  function replace(parent, ...children) {
    parent.replaceChildren();
    append(parent, children);
  }

  /* Returns a table: `columns` are {title, isNumber}, `rows` are lists of texts or elements. */
  function table(columns, rows, properties = {}) {
    const cell = (tag, content, column) =>
      element(tag, { className: column.isNumber ? "number" : null }, content);

    const head = element(
      "tr",
      {},
      columns.map((column) => cell("th", column.title, column)),
    );
    const body = rows.map((row) =>
      element(
        "tr",
        {},
        row.map((content, index) => cell("td", content, columns[index])),
      ),
    );
    const made = element(
      "table",
      properties,
      element("thead", {}, head),
      element("tbody", {}, body),
    );
    return element("div", { className: "table-frame" }, made);
  }

  /* Returns a number with so many decimals and its unit; a dash for what is not known. */
  function number(value, decimals = 2, unit = "") {
    if (value === null || value === undefined || !Number.isFinite(value)) return "–";
    const text = value.toFixed(decimals).replace("-", "−");
    return unit ? `${text} ${unit}` : text;
  }

  /* Returns a time of the flight as minutes and seconds: 1:02.50. */
  function clock(time_s, decimals = 1) {
    if (!Number.isFinite(time_s)) return "–";
    const sign = time_s < 0 ? "−" : "";
    const unit = 10 ** decimals;
    const rounded_s = Math.round(Math.abs(time_s) * unit) / unit;
    const minutes = Math.floor(rounded_s / 60);
    const seconds = (rounded_s - 60 * minutes).toFixed(decimals);
    return `${sign}${minutes}:${seconds.padStart(decimals ? 3 + decimals : 2, "0")}`;
  }

  Object.assign(Covey, { element, replace, table, number, clock });
})();
