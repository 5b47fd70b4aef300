// The elements of a page by their data-live names.

export const $ = (name) => document.querySelector(`[data-live="${name}"]`);
export const $$ = (name) => document.querySelectorAll(`[data-live="${name}"]`);

export function put(name, text, state) {
  for (const element of $$(name)) {
    if (element.textContent !== text) element.textContent = text;
    if (state !== undefined && element.dataset.state !== state) element.dataset.state = state;
  }
}

const filled = {};

// A list of rows.  Only changed rows are replaced: a button that is replaced between press and release is never clicked.
export function fill(name, data, row, empty) {
  const text = JSON.stringify(data);
  if (filled[name] === text && $(name)?.childElementCount) return;
  filled[name] = text;
  for (const place of $$(name)) place.replaceChildren(...(data.length ? data.map(row) : [cell("div", empty, "empty")]));
}

// A new element with text in it: nothing from the bus is ever put into a page as HTML.
export function cell(tag, text, className) {
  const element = document.createElement(tag);
  element.textContent = text;
  if (className) element.className = className;
  return element;
}
