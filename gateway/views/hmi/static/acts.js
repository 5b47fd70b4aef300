// The controls: buttons and forms into requests.  Rule: a press is answered, or shown as not sent.

import { cell as element, put } from "./dom.js";
import { act, page, server } from "./server.js";
import { textOf, textsOf } from "./texts.js";

const SURE_MS = 5000;
const COUNT_M = 5e-7; // the board's reference is in counts of its converter: smaller differences are rounding
const metres = (mm) => mm / 1e3; // not mm * 1e-3: 5.2 * 1e-3 is above 0.0052
const command = (name, body) => act(name, `/api/${page.board}/command`, body);
const job = (name, body) => act(name, `/api/${page.board || "*"}/job`, body);

// What a form sends: {name: what it is called, path or body}.  Numbers leave in SI units.
const FORMS = {
  reference: (f) => ({ name: textOf("reference.act", { mm: f.mm }), send: (name) => command(name, { set_reference: { x_ref_m: metres(f.mm) } }) }),
  excitation: (f) => {
    const on_reference = f.on === "reference", si = on_reference ? metres : Number, unit = on_reference ? "mm" : "V";
    const excite = { shape: f.shape, on_reference, amplitude: si(f.amplitude), offset: si(f.offset), period_s: Number(f.period),
                     period_end_s: f.shape === "SHAPE_CHIRP" ? Number(f.period_end) : 0, seed: 1, duration_s: Number(f.duration) };
    const shape = textsOf("shape")[f.shape.replace("SHAPE_", "").toLowerCase()], { amplitude, offset, duration: seconds } = f;
    const name = excite.duration_s ? textOf("excitation.act_for", { shape, amplitude, offset, unit, seconds })
                                   : textOf("excitation.act", { shape, amplitude, offset, unit });
    return { name, send: (name) => command(name, { excite }) };
  },
  recording: (f) => ({ name: textOf("recording.act"), send: (name) => job(name, { kind: "record", act: "start", title: f.title }) }),
  design: (f) => ({ name: textOf("work.design_act"), send: (name) => job(name, { kind: "design", act: "start", ...f }) }),
  compare: (f) => ({ name: textOf("compare.act"), send: (name) => job(name, { kind: "compare", act: "start", ...f }) }),
  rename: (f) => ({ name: textOf("campaigns.rename_act"), send: (name) => changed(act(name, `/api/${page.board}/campaign`, { act: "rename", ...f })) }),
  mark: (f) => ({ name: textOf("recording.mark_act", { text: f.text }), send: (name) => command(name, { mark: { text: f.text } }) }),
};

// Fetch again what the page shows of a campaign.
async function changed(request) {
  const answer = await request;
  if (answer?.accepted) document.dispatchEvent(new Event("board51-changed"));
  return answer;
}

async function submit(form) {
  const { name, send } = FORMS[form.dataset.form](Object.fromEntries(new FormData(form)));
  const answer = await send(name);
  // A refused value must not look as if it were in force.
  form.dataset.refused = answer?.accepted ? "" : "yes";
  if (form.dataset.form !== "reference") return;
  form.dataset.unsent = "";
  if (!answer?.accepted) follow(latest, old, true);
}

const ACTS = {
  acknowledge: (b) => act(textOf("alarm.acknowledge_act", { alarm: b.dataset.name }), `/api/${page.board}/acknowledge`, { name: b.dataset.name }),
  "acknowledge-all": (b) => (b.dataset.fault && !sure(b, textOf("alarm.acknowledge_all_sure"))) ||
    act(textOf("alarm.acknowledge_all_act"), `/api/${page.board}/acknowledge`, { names: JSON.parse(b.dataset.names) }),
  shelve: (b) => (b.dataset.fault && !sure(b, textOf("alarm.shelve_sure"))) ||
    act(textOf("alarm.shelve_act", { alarm: b.dataset.name, span: textsOf("shelf")[b.dataset.seconds] }),
        `/api/${page.board}/acknowledge`, { name: b.dataset.name, shelve_s: Number(b.dataset.seconds) }),
  unshelve: (b) => act(textOf("alarm.unshelve_act", { alarm: b.dataset.name }), `/api/${page.board}/acknowledge`, { name: b.dataset.name }),
  "end-excitation": () => command(textOf("excitation.end_act"), { excite: { shape: "SHAPE_NONE", on_reference: latest?.mode !== "open loop" } }),
  "log-out": async () => {
    await fetch("/logout", { method: "POST", headers: { "x-board51-token": page.token } }).catch(() => null);
    location.href = "/login";
  },
  delete: deleteForGood,
  remove: (b) => act(textOf("library.remove_act", { rig: b.dataset.board }), `/api/${b.dataset.board}/remove`, {}),
  close: (b) => b.closest("dialog").close(),
  summary,
};

async function pressed(button) {
  button.setAttribute("aria-busy", "true");
  try {
    if (button.dataset.command) await command(button.textContent, JSON.parse(button.dataset.command));
    else if (button.dataset.job) {
      const answer = await job(button.textContent, JSON.parse(button.dataset.job));
      if (answer?.accepted && button.dataset.then) location.href = button.dataset.then;
    } else await ACTS[button.dataset.act]?.(button);
  } finally {
    button.removeAttribute("aria-busy");
  }
}

// The second click of a double click, and a press while the first one waits for its answer, do not count.
let before = null; // the button of the last click

document.addEventListener("click", (event) => {
  const button = event.target.closest?.("button");
  if (!button || button.dataset.act === "stop") return;
  const again = button === before && event.detail > 1;
  before = button;
  if (again || button.hasAttribute("aria-busy")) event.preventDefault();
  else if (button.matches("[data-command], [data-job], [data-act]")) pressed(button);
});
document.addEventListener("submit", (event) => {
  if (!event.target.dataset.form) return;
  event.preventDefault();
  submit(event.target);
});
document.addEventListener("input", (event) => {
  const form = event.target.closest?.("form[data-form]");
  if (!form) return;
  form.dataset.refused = "";
  if (form.dataset.form === "reference") {
    form.dataset.unsent = "yes";
    const other = event.target.name === "slide" ? form.mm : form.slide;
    other.value = event.target.value;
  }
  if (form.dataset.form === "excitation") units(form);
});
document.addEventListener("change", (event) => {
  if (event.target.dataset?.slider) submit(event.target.form); // when the handle is released, not while it moves
  if (event.target.dataset?.file) gains(event.target);
});

function units(form) {
  const unit = form.elements.on.value === "reference" ? "mm" : "V";
  form.querySelector("[data-label=amplitude]").textContent = textOf("excitation.amplitude", { unit });
  form.querySelector("[data-label=offset]").textContent = textOf("excitation.offset", { unit });
  form.period_end.closest("label").hidden = form.elements.shape.value !== "SHAPE_CHIRP";
}
for (const form of document.querySelectorAll("[data-form=excitation]")) units(form);

// --- the reference in force -------------------------------------------------------------------------------------------

let latest = null, old = false, followed = NaN;

// Show the reference that samples say is in force, or said last where `gone`; what was typed and is not sent yet is left
// alone unless `force`.
export function follow(now, gone, force = false) {
  [latest, old] = [now, gone];
  const form = document.querySelector("[data-form=reference]"), x_ref = now?.x_ref_m;
  if (!form || x_ref === null || x_ref === undefined) return;
  const unsent = form.dataset.unsent === "yes", mm = (x_ref * 1e3).toFixed(3);
  if (gone) put("reference-now", unsent ? textOf("reference.last_known_unsent", { mm }) : textOf("reference.last_known", { mm }));
  else put("reference-now", unsent ? textOf("reference.in_force_unsent", { mm }) : textOf("reference.in_force", { mm }));
  if (!force && (unsent || Math.abs(x_ref - followed) < COUNT_M)) return;
  followed = x_ref;
  form.mm.value = form.slide.value = mm;
}

// What gateway and board both let through.
export function limits(rest) {
  const form = document.querySelector("[data-form=reference]"), l = rest.limits;
  if (!form || !l || !(l.x_max_mm > l.x_min_mm)) return;
  const [low, high] = [l.x_min_mm, l.x_max_mm];
  Object.assign(form.slide, { min: low, max: high });
  put("reference-range", textOf("reference.range", { low, high, step: Number((l.step_m * 1e3).toPrecision(2)) }));
}

// --- jobs, gains, summaries ---------------------------------------------------------------------------------------------

const IDLE_WORDS = { record: textOf("recording.idle") };
const KINDS = ["record", "campaign", "identify", "validate", "diagnose", "hand-over", "compare", "design", "forecast", "bode"];

export function showJobs(jobs) {
  for (const kind of KINDS) {
    const job = jobs[kind], running = Boolean(job?.running);
    for (const element of document.querySelectorAll(`[data-idle=${kind}]`)) element.hidden = running;
    for (const element of document.querySelectorAll(`[data-running=${kind}]`)) element.hidden = !running;
    for (const element of document.querySelectorAll(`[data-details=${kind}]`)) element.hidden = !job;
    for (const bar of document.querySelectorAll(`[data-progress=${kind}]`)) {
      bar.hidden = !running;
      if (job?.progress === null || !job) bar.removeAttribute("value"); // it moves, and says nothing of how long
      else bar.value = job.progress;
    }
    put(`${kind}-said`, job ? progress(kind, job) : IDLE_WORDS[kind] ?? "", job?.failed ? "bad" : "none");
    put(`${kind}-lines`, (job?.lines ?? []).join("\n"));
  }
  document.dispatchEvent(new CustomEvent("board51-jobs", { detail: jobs }));
}

function progress(kind, { title, who, standing: state, running, lines }) {
  const job = running ? textOf("job.running_of", { title, who, state }) : textOf("job.ended_of", { title, who, state });
  return kind === "record" && lines.length ? textOf("job.with_line", { job, line: lines.at(-1) }) : job;
}

// A file is read by the server and shown; it is sent by a press of its own.
async function gains(input) {
  const file = input.files[0], preview = document.querySelector(".preview");
  preview.replaceChildren();
  if (!file) return;
  const answer = await act(textOf("gains.read_act", { file: file.name }), `/api/${page.board}/gains`, file);
  input.value = "";
  if (!answer) return;
  if (!answer.accepted) return preview.replaceChildren(element("div", textOf("gains.refused", { file: file.name, text: answer.text }), "refused"));
  const table = element("table", "", "gains-table");
  for (const row of [{ name: "", now: textOf("gains.now"), new: textOf("gains.new"), unit: "" }, ...answer.rows]) {
    const line = element("tr", "");
    line.append(...["name", "now", "new", "unit"].map((name) => element("td", row[name])));
    table.append(line);
  }
  const send = element("button", textOf("gains.send"), "filled"), discard = element("button", textOf("gains.discard"), "plain");
  send.onclick = async () => (await command(textOf("gains.send_act", { file: file.name }), answer.command))?.accepted && preview.replaceChildren();
  discard.onclick = () => preview.replaceChildren();
  const buttons = element("div", "", "row-of");
  buttons.append(send, discard);
  preview.replaceChildren(element("div", textOf("gains.preview", { file: file.name, law: answer.law }), "hint"), table, buttons);
}

// Asks by a second press, and forgets the first one after a while.  True where it was the second.
function sure(button, question) {
  const words = button.textContent;
  if (button.dataset.sure === "yes") return true;
  button.dataset.sure = "yes";
  button.textContent = question;
  setTimeout(() => {
    button.dataset.sure = "";
    button.textContent = words;
  }, SURE_MS);
  return false;
}

async function deleteForGood(button) {
  if (!sure(button, textOf("library.delete_sure"))) return;
  const { log, campaign } = button.dataset, name = textOf("library.delete_act", { log: log ?? campaign });
  const answer = log ? await act(name, "/api/*/delete", { log }) : await act(name, `/api/${page.board}/campaign`, { name: campaign, act: "delete" });
  if (!answer?.accepted) return;
  if (campaign) location.href = `/model/${page.board}`; // the page may be that of this campaign
  else button.closest(".file").remove();
}

document.querySelector("[data-filter=log]")?.addEventListener("input", (event) => {
  const wanted = event.target.value.toLowerCase();
  for (const row of document.querySelectorAll(".log")) row.hidden = !row.textContent.toLowerCase().includes(wanted);
});

function summary(button) {
  return showText(button.dataset.log, `/api/summary/${button.dataset.log}`);
}

document.querySelector("form.sessions")?.addEventListener("submit", (event) => {
  event.preventDefault();
  const condition = new FormData(event.target).get("where");
  showText(condition, `/api/sessions?where=${encodeURIComponent(condition)}`);
});

async function showText(name, path) {
  const dialog = document.querySelector("dialog.summary"), text = dialog.querySelector(".summary-text");
  dialog.querySelector(".file-name").textContent = name;
  text.textContent = textOf("library.reading");
  dialog.show(); // not modal: STOP stays within reach
  try {
    const answer = await server.ask(path, null, { method: "GET", limit: 130 });
    text.textContent = answer.text;
  } catch (error) {
    text.textContent = textOf("library.unreadable", { error: error.message });
  }
}

