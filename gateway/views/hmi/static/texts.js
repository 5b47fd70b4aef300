// The texts of the pages: gateway/views/hmi/texts.toml, which the page brings along.

const TEXTS = JSON.parse(document.querySelector("meta[name=board51]").dataset.texts);

// The text of "section.name", each {placeholder} replaced by its value.  A text that is missing must not hold up a STOP:
// its key is shown.
export function textOf(key, values = {}) {
  const [section, name] = key.split(".");
  return (TEXTS[section]?.[name] ?? key).replace(/\{(\w+)\}/g, (placeholder, name) => values[name] ?? placeholder);
}

// The texts of a section by their names, for names that come from data, such as the state of a link.
export const textsOf = (section) => TEXTS[section] ?? {};
