// The alarms of a rig in the groups of ISA-18.2, and their journal.
//
// Rule: a row stays the same element while its alarm is listed, only its words change: a button that is replaced
// between press and release is never clicked.

import { $, cell, fill } from "./dom.js";
import { may, page } from "./server.js";
import { textOf, textsOf } from "./texts.js";

const GROUPS = textsOf("alarm_group");
const rows = new Map(); // name: {row, standing, at, seen, text, acts}

export function showAlarms(alarms) {
  const place = $("alarms");
  if (!place) return;
  if (!place.querySelector(".alarm-group")) place.replaceChildren(...Object.keys(GROUPS).map(group), cell("div", textOf("alarm.none"), "empty"));
  for (const name of [...rows.keys()].filter((one) => !alarms.some((alarm) => alarm.name === one))) {
    rows.get(name).row.remove();
    rows.delete(name);
  }
  for (const name of Object.keys(GROUPS)) {
    const its = alarms.filter((alarm) => alarm.group === name), box = place.querySelector(`[data-group=${name}]`);
    box.hidden = !its.length;
    box.firstChild.textContent = `${GROUPS[name]} (${its.length})`;
    its.forEach((alarm, n) => {
      const row = shown(alarm);
      if (box.children[n + 1] !== row) box.insertBefore(row, box.children[n + 1] ?? null);
    });
  }
  place.lastChild.hidden = alarms.length > 0;
  const button = document.querySelector("[data-act=acknowledge-all]");
  if (!button) return;
  const waiting = alarms.filter((alarm) => ["unacknowledged", "returned"].includes(alarm.group));
  button.disabled = !waiting.length;
  button.dataset.names = JSON.stringify(waiting.map((alarm) => alarm.name));
  button.dataset.fault = waiting.some((alarm) => alarm.active && alarm.severity === "fault") ? "yes" : "";
}

function group(name) {
  const box = cell("div", "", "alarm-group");
  box.dataset.group = name;
  box.append(cell("h3", "", "group-title"));
  return box;
}

function shown(alarm) {
  if (!rows.has(alarm.name)) rows.set(alarm.name, make(alarm));
  const { row, standing, at, seen, text, acts } = rows.get(alarm.name), { since, times } = alarm;
  const say = (element, words) => element.textContent === words || (element.textContent = words);
  row.dataset.state = alarm.active ? (alarm.severity === "fault" ? "fault" : "warning") : "gone";
  say(standing, textsOf("alarm_state")[row.dataset.state]);
  say(at, times > 1 ? textOf("alarm.times", { since, times }) : since);
  const { by: name, until } = alarm, isShelved = alarm.group === "shelved";
  say(seen, isShelved ? textOf("alarm.shelved_until", { name, until }) : alarm.acknowledged ? textOf("alarm.acknowledged", { name }) : "");
  say(text, alarm.text);
  if (acts.dataset.group !== alarm.group) acts.replaceChildren(...buttons(alarm));
  acts.dataset.group = alarm.group;
  return row;
}

function make(alarm) {
  const row = cell("div", "", "alarm"), parts = { row };
  for (const name of ["standing", "name", "at", "text"]) row.append((parts[name] = cell("span", "", name)));
  parts.name.textContent = alarm.name;
  const foot = cell("div", "", "foot");
  if (alarm.model && !page.replay) { // the model's page is that of the live rig
    const link = cell("a", textOf("alarm.to_model"), "to-model");
    link.href = `/model/${page.board}`;
    foot.append(link);
  }
  for (const name of ["seen", "acts"]) foot.append((parts[name] = cell("span", "", name)));
  row.append(foot);
  return parts;
}

function button(words, act, alarm, className = "ack") {
  const made = cell("button", words, className);
  made.type = "button";
  Object.assign(made.dataset, { act, name: alarm.name });
  return made;
}

function buttons(alarm) {
  if (!may.has("acknowledge")) return [];
  if (alarm.group === "shelved") return [button(textOf("alarm.unshelve"), "unshelve", alarm)];
  const all = alarm.acknowledged ? [] : [button(textOf("alarm.acknowledge"), "acknowledge", alarm)];
  if (!alarm.active) return all;
  const shelf = cell("span", "", "shelf"), open = cell("button", textOf("alarm.shelve"), "ack");
  shelf.hidden = true;
  open.type = "button";
  open.setAttribute("aria-expanded", "false");
  open.onclick = () => open.setAttribute("aria-expanded", String(!(shelf.hidden = !shelf.hidden)));
  shelf.append(cell("span", textOf("alarm.shelve_for"), "hint"));
  for (const [seconds, span] of Object.entries(textsOf("shelf"))) {
    const one = button(span, "shelve", alarm);
    Object.assign(one.dataset, { seconds, fault: alarm.severity === "fault" ? "yes" : "" });
    shelf.append(one);
  }
  return [...all, open, shelf];
}

// [words, state] for the bar: how many alarms hold.  Those that are gone or shelved are not counted among them.
export function counted(alarms) {
  const count = (group) => alarms.filter((alarm) => alarm.group === group).length;
  const active = alarms.filter((a) => a.active && a.group !== "shelved"), fault = active.some((a) => a.severity === "fault");
  const gone = count("returned"), state = fault ? "bad" : active.length + gone ? "warn" : "good";
  return [alarmWords(active.length, gone, fault, count("shelved")), state];
}

export function alarmWords(active, gone, fault, shelved) {
  const words = holding(active, gone, fault);
  return shelved ? textOf("alarm.with_shelved", { words, count: shelved }) : words;
}

function holding(active, gone, fault) {
  const ended = { gone: textOf("alarm.gone_count", { count: gone }) };
  if (!active) return gone ? textOf("alarm.none_active", ended) : textOf("alarm.none");
  const mark = fault ? "\u2716" : "\u25b2", words = active > 1 ? textOf("alarm.many", { mark, count: active }) : textOf("alarm.one", { mark });
  return gone ? textOf("alarm.with_gone", { active: words, ...ended }) : words;
}

// --- the journal ------------------------------------------------------------------------------------------------------

const filter = document.querySelector("[data-filter=journal]");

function sift() {
  const wanted = filter.value.toLowerCase();
  for (const row of $("journal").children) row.hidden = !row.textContent.toLowerCase().includes(wanted);
}
filter?.addEventListener("input", sift);

export function showJournal(entries) {
  if (!filter) return;
  fill("journal", entries, ({ at, name, what, text, severity }) => {
    const row = cell("div", "", "entry");
    row.dataset.state = severity;
    row.append(cell("span", at, "at"), cell("span", name, "name"), cell("span", text ? `${what}: ${text}` : what, "text"));
    return row;
  }, textOf("journal.none"));
  sift();
}
